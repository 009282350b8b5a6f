"""Every rule of docs/developers/protocol.md is there in these words, and something holds a device, or a host, to it."""

import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from test_conformance import examined
from test_protocol_page import VECTORS

from retuner.drivers.conformance.examination import Examination
from retuner.drivers.controller.virtual_device import VirtualDevice

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGE = (ROOT / "docs" / "developers" / "protocol.md").read_text(encoding="utf-8")
RULES = tomllib.loads((HERE / "protocol_rules.toml").read_text(encoding="utf-8"))
HOLDERS = {"conformance", "vectors", "layer", "host", "open"}
NO_RULES = {"What this version does not do", "A session, byte by byte"}  # Chapters that tell and ask nothing


def plain(text: str) -> str:
    """One line, as it is compared."""
    return " ".join(text.split())


def chapters() -> dict[str, str]:
    parts = re.split(r"^## (.*)$", PAGE, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def rules() -> Iterator[tuple[str, str, dict[str, str]]]:
    for chapter, found in RULES.items():
        for says, held in found.items():
            yield chapter, says, held


@cache
def tried() -> dict[str, set[str]]:
    """What the examination says that it tries, by chapter, with and without a key."""
    said: dict[str, set[str]] = {}
    with pytest.MonkeyPatch.context() as patch:
        for name in ("expect", "holds"):
            patch.setattr(Examination, name, noting(getattr(Examination, name), said))
        examined(VirtualDevice)
        examined(VirtualDevice, key=None)
    return said


def noting(own: Callable[..., bool], said: dict[str, set[str]]) -> Callable[..., bool]:
    """The same, and what it was told is written down."""

    def noted(found: Examination, what: str, *rest: object) -> bool:
        said.setdefault(found.chapter, set()).add(what)
        return own(found, what, *rest)

    return noted


def test_the_page_has_every_rule_in_these_words() -> None:
    page = {name: plain(text) for name, text in chapters().items()}
    assert [(chapter, says) for chapter, says, _ in rules() if says not in page[chapter]] == []
    assert set(RULES) == set(page) - NO_RULES


def test_every_rule_is_held_by_something() -> None:
    assert [says for _, says, held in rules() if not held.keys() & HOLDERS or held.keys() - HOLDERS - {"in"}] == []


def test_what_the_examination_tries_is_what_the_rules_name() -> None:
    named: dict[str, set[str]] = {}
    for chapter, _, held in rules():
        if "conformance" in held:
            named.setdefault(held.get("in", chapter), set()).add(held["conformance"])
    missing = [
        (chapter, name)
        for chapter, names in named.items()
        for name in names
        if not any(said.startswith(name) for said in tried()[chapter])
    ]
    assert missing == [], "\n".join(map(str, missing))
    assert set(tried()) <= set(chapters())


def test_the_sessions_that_the_rules_name_are_there() -> None:
    named = {held["vectors"] for _, _, held in rules() if "vectors" in held}
    assert named - {case["name"] for case in VECTORS["cases"]} == set()


def test_the_judges_and_the_tests_that_the_rules_name_are_there() -> None:
    folder = ROOT / "benchmarks" / "bus_simulation"
    judges = "\n".join(path.read_text() for path in (folder / "truth.py", *sorted((folder / "layers").glob("*.py"))))
    assert {held["layer"] for _, _, held in rules() if "layer" in held and held["layer"] not in judges} == set()
    assert {held["host"] for _, _, held in rules() if "host" in held and not (HERE / held["host"]).is_file()} == set()


def test_no_sentence_with_a_word_of_duty_is_without_a_rule() -> None:
    """Sentences on what must, may, never or only happens, outside tables and printed frames."""
    duty = re.compile(r"\b(must|never|refuses?|only|answers?|until|burn[st]?|burnt)\b")
    missing = []
    for chapter, text in chapters().items():
        if chapter in NO_RULES:
            continue
        body = re.sub(r"^\|.*$|^    .*$|^<!--.*-->$", "", text, flags=re.MULTILINE)
        for sentence in re.split(r"(?<=[.:])\s+", plain(body)):
            told = [says for says in RULES[chapter] if says in sentence or sentence in says or overlaps(says, sentence)]
            if duty.search(sentence) and not told:
                missing.append((chapter, sentence))
    assert missing == [], "\n".join(map(str, missing))


def overlaps(says: str, sentence: str) -> bool:
    """Whether one begins within the other: a rule may take two sentences, or parts of them."""
    return says[:25] in sentence or says[-25:] in sentence
