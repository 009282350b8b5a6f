"""Every pattern that meets input takes time in proportion to its length: a field without end hangs nobody."""

import importlib
import re
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    "drivers",
    "schedule",
    "src/retuner/config",
    "src/retuner/session",
    "src/retuner/audit",
    "src/retuner/gain_export",
)
LENGTH = 4_000
MOST_S = 0.06  # CPU time; a pattern that tries every split takes 8 million steps, 0.2 s at the least
PUMPED = ("1", "1,", "1.", "-1", "a", "A", "aA1 ", "1 ", *" \t\n[(", "# ", "[0000]", '"', "\\", "'", "=", "e1")
ENDS = ("", "x", "!", "]", "\n", "e+")
HEADS = ("", "[", '"', "1", "# ", "BaudRate_")


def patterns() -> dict[str, tuple[re.Pattern[str], frozenset[str]]]:
    """Patterns by module and name, each with what is done with it anywhere in its module or by those that import it."""
    texts = {path: path.read_text(encoding="utf-8") for room in ROOMS for path in (ROOT / room).rglob("*.py")}
    found = {}
    for path, text in texts.items():
        parts = path.relative_to(ROOT).with_suffix("").parts
        module = ".".join(parts[1:] if parts[0] == "src" else ("retuner", *parts))
        for name in re.findall(r"^(\w+) = re\.compile\(", text, re.MULTILINE):
            using = [each for each in texts.values() if each is text or re.search(rf"import .*\b{name}\b", each)]
            done = frozenset(how for each in using for how in re.findall(rf"\b{name}\.(\w+)\(", each))
            found[f"{module}.{name}"] = getattr(importlib.import_module(module), name), done
    return found


FOUND = patterns()


def applied(pattern: re.Pattern[str], how: str, text: str) -> None:
    """What the code does with it, whole: an iterator is run out."""
    if how in {"sub", "subn"}:
        pattern.sub("", text)
    elif how == "finditer":
        list(pattern.finditer(text))
    else:
        getattr(pattern, how)(text)


@pytest.mark.parametrize("name", FOUND)
def test_a_pattern_is_linear_in_what_it_reads(name: str) -> None:
    pattern, done = FOUND[name]
    assert done or name.endswith("NUMBER")
    for how in done & {"match", "fullmatch", "search", "sub", "subn", "finditer", "findall", "split"}:
        for pump in PUMPED:
            for head, end in [(head, "") for head in HEADS] + [("", end) for end in ENDS]:
                text = head + pump * (LENGTH // len(pump)) + end
                begun = time.process_time()
                applied(pattern, how, text)
                assert time.process_time() - begun < MOST_S, (how, head, pump, end)
