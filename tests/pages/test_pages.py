"""What README and docs print is what happens: commands are there with their options, and blocks print what they say."""

import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from effort import EFFORT
from once import once
from readme_renderer import markdown
from typer.main import get_command

from retuner.cli import COMMANDS, app_of

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
import run_pages  # noqa: E402  stands in scripts/
from docstring_markup import as_rst  # noqa: E402
from run_pages import agrees, blocks, rewritten  # noqa: E402

FRONT = {"README", "start", "diagnose", "concepts"}
"""What a newcomer copies from; the other pages take minutes, and are the nightly's."""
RUN = [page for page in run_pages.pages() if page.stem in FRONT or EFFORT.name == "nightly"]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.slow
@pytest.mark.uncounted
@pytest.mark.parametrize("page", RUN, ids=lambda page: page.stem)
def test_what_a_page_prints_is_what_comes(page: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    def oven() -> Path:
        return once(tmp_path_factory, "pages-oven", run_pages.make_oven)

    for block, came, status in run_pages.run_page(page, tmp_path, oven):
        said = f"{page.name}:{block.line}: {block.code}\n--- came, status {status}:\n{came}"
        assert status == block.status, said
        assert block.printed is None or agrees(block.printed, came), (
            f"{said}\n(scripts/run_pages.py --write puts it in)"
        )


@pytest.mark.nightly
def test_notebooks_show_what_comes() -> None:
    script = ROOT / "scripts" / "run_notebooks.py"
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}\n(scripts/run_notebooks.py --write takes it)"


def commands(code: str) -> list[list[str]]:
    """The calls of retuner in a block of sh, as words."""
    lines = [shlex.split(line.partition(" | ")[0], comments=True) for line in code.replace("\\\n", " ").splitlines()]
    return [words[1:] for words in lines if words[:1] == ["retuner"]]


def unknown(words: list[str]) -> list[str]:
    """What the command line has not: the command itself, or options of it."""
    name, rest = (words or [""])[0], words[1:]
    if name not in COMMANDS:
        return [] if name.startswith("-") else [name]
    command = get_command(app_of(name))
    inside = getattr(command, "commands", None)
    if inside is not None:
        if rest[:1] and rest[0] not in inside:
            return [rest[0]]
        command = inside[rest[0]] if rest else command
    known = {option for one in command.params for option in (*one.opts, *one.secondary_opts)} | {"--help", "-h"}
    return [word for word in rest if re.match(r"--?[a-z]", word) and word.partition("=")[0] not in known]


def test_every_command_of_a_page_is_there_with_its_options() -> None:
    told = [
        (page.name, words)
        for page in PAGES
        for block in blocks(page.read_text(encoding="utf-8"))
        if block.kind == "sh"
        for words in commands(block.code)
    ]
    assert len(told) > 15
    assert [(name, words) for name, words in told if unknown(words)] == []


def test_the_check_sees_commands_and_options_that_are_not_there() -> None:
    assert unknown(["tune", "--all", "--nonsense"]) == ["--nonsense"]
    assert unknown(["guess"]) == ["guess"]
    assert unknown(["ledger", "burn"]) == ["burn"]
    assert commands("retuner check a.toml | head  # or so\nls\n") == [["check", "a.toml"]]


@pytest.mark.parametrize(
    ("told", "came", "same"),
    [
        ("Ms 1.59", "Ms 1.60", True),
        ("Ms 1.59", "Ms 1.70", False),
        ("42,230 of 7", "42,230 of 7", True),
        ("21 decisions", "22 decisions", False),
        ("head ...", "head 68cd5d", True),
        ("a\n...\nz", "a\nb\nc\nz", True),
        ("a\n...\nz", "a\nb\nc", False),
        ("...", "", True),
        ("a  b", "a b", True),
        ("a", "a\nb", False),
        ("-0.5 %", "0.5 %", False),
    ],
)
def test_what_comes_is_compared_by_words_and_nearly_by_numbers(told: str, came: str, same: bool) -> None:
    assert agrees(told, came) is same


def test_a_page_is_rewritten_with_as_much_as_it_told() -> None:
    page = "x\n\n```sh\nls\n```\n\n```text\na\n...\ny\nz\n```\n\nend\n"
    (block,) = blocks(page)
    assert rewritten(page, block, "1\n2\n3\n4\n") == "x\n\n```sh\nls\n```\n\n```text\n1\n...\n3\n4\n```\n\nend\n"


def test_notes_before_a_block_say_what_is_special() -> None:
    page = "<!-- not run: no bus -->\n```sh\na\n```\n\n<!-- status 1 -->\n```sh\nb\n```\n\n```sh\nc <your file>\n```\n"
    assert [(block.to_run, block.status) for block in blocks(page)] == [(False, 0), (True, 1), (False, 0)]


def test_simulated_records_are_what_their_script_makes() -> None:
    script = runpy.run_path(str(ROOT / "examples" / "make_records.py"))
    for name, loop in script["LOOPS"].items():
        rows = (ROOT / "examples" / "records" / name).read_text().splitlines()[1:]
        assert [",".join(f"{x:.6g}" for x in row) for row in loop.record()] == rows, name


def test_every_record_is_named_with_where_it_is_from() -> None:
    told = (ROOT / "examples" / "records" / "README.md").read_text(encoding="utf-8")
    records = {path.name for path in (ROOT / "examples" / "records").iterdir()} - {"README.md"}
    assert set(re.findall(r"^\| `([\w.]+)` \|", told, flags=re.MULTILINE)) == records


def test_docstrings_become_items_and_formulas() -> None:
    lines = as_rst(
        "One.\n\n    a : of *b*. c, d : two\n        lines.\n\n    Raises\n    ------\n    ValueError\n        Bad.\n"
    )
    assert [line for line in lines if line] == [
        "One.",
        "- ``a``: of \\*b\\*.",
        "- ``c, d``: two lines.",
        ".. rubric:: Raises",
        "- ``ValueError``: Bad.",
    ]


def test_the_package_index_shows_readme_with_every_link_and_picture() -> None:
    shown = markdown.render((ROOT / "README.md").read_text(encoding="utf-8"))
    assert shown is not None
    links = re.findall(r'(?:href|src)="([^"#]+)"', shown)
    assert len(links) > 10
    repository = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]["Source"]
    raw = repository.replace("https://github.com/", "https://raw.githubusercontent.com/")
    homes = (repository, f"{repository}/blob/main/", f"{raw}/main/")
    for link in links:
        home = next((home for home in reversed(homes) if link.startswith(home)), None)
        assert home is not None, link
        assert (ROOT / link.removeprefix(home)).exists(), link
