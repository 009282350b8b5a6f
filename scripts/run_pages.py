"""Run what the pages print, as printed, and compare what comes: every ```sh and ```python block of README and docs.

    python scripts/run_pages.py                     # all pages
    python scripts/run_pages.py docs/start.md       # one
    python scripts/run_pages.py --write README.md   # put what comes now in place of what stood there

Each page is run from its top in a fresh folder that holds a copy of examples/, as a new user would. A ```text block
right after a block is what that block prints: `...` is the rest of a line or, alone on a line, any number of
lines; numbers may differ by a per cent. A comment before a block says what is special about it:

    <!-- not run: why -->        it needs what a test has not: hardware, a network, an hour
    <!-- in the background -->   it goes on while the blocks after it run, and is stopped at the end
    <!-- status 1 -->            its exit status, where it is not 0
    <!-- with runs/demo -->      of a page: the session that `make demo` leaves lies in the folder

A command with a <placeholder> is not run. The oven, which takes longest and stands on more pages than one, is run once.
"""

import argparse
import fcntl
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(
    r"(?:<!-- (?P<note>[^>]*) -->\n)?^```(?P<kind>sh|python)\n(?P<code>.*?)^```\n"
    r"(?:\n```text\n(?P<printed>.*?)^```\n)?",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
TOLERANCE = 0.01
LONGEST_S = 300
WIDTH = "100"
DEMO = "runs/demo"
OVEN = "run examples/oven.toml --out runs/oven"
"""The longest command, which more pages than one print: it is run once."""


@dataclass(frozen=True)
class Block:
    """One block of a page: its language, code, the comment before it, what it prints (None: not told), and its line."""

    kind: str
    code: str
    note: str
    printed: str | None
    line: int

    @property
    def status(self) -> int:
        """The exit status that it promises."""
        return int(self.note.removeprefix("status ")) if self.note.startswith("status ") else 0

    @property
    def to_run(self) -> bool:
        """Whether it can be run here."""
        return not self.note.startswith("not run: ") and not re.search(r"<[A-Za-z][^>\n]*>", self.code)


def blocks(text: str) -> list[Block]:
    """The blocks of a page, in order."""
    return [
        Block(
            found["kind"], found["code"], found["note"] or "", found["printed"], text[: found.start()].count("\n") + 1
        )
        for found in BLOCK.finditer(text)
    ]


def pages() -> list[Path]:
    """Pages with something to run."""
    every = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in every if any(block.to_run for block in blocks(page.read_text(encoding="utf-8")))]


def run_page(page: Path, folder: Path, oven: Callable[[], Path]) -> Iterator[tuple[Block, str, int]]:
    """Each block that can be run with what it printed and its exit status, in a fresh folder.

    oven : where make_oven left its run, which is `make demo`'s as well; asked when a page needs it.
    """
    shutil.copytree(ROOT / "examples", folder / "examples", ignore=shutil.ignore_patterns("__pycache__"))
    text = page.read_text(encoding="utf-8")
    if f"<!-- with {DEMO} -->" in text:
        shutil.copytree(oven() / "runs" / "oven", folder / DEMO)
    with alone() if "<!-- in the background -->" in text else nullcontext(), background() as started:
        for block in blocks(text):
            if block.to_run and block.note == "in the background":
                quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
                start = subprocess.Popen(
                    _command(block), cwd=folder, env=_environment(), start_new_session=True, **quiet
                )
                started.append(start)
            elif block.to_run:
                before = copying(oven()) if OVEN in block.code else ""
                yield (block, *_run(block, folder, before))


@cache
def oven_here() -> Path:
    """The run of the oven that pages print, run once."""
    folder = Path(tempfile.mkdtemp(prefix="retuner-pages-"))
    make_oven(folder)
    return folder


def make_oven(folder: Path) -> None:
    """Run the oven in a folder, as pages print it; what it prints is kept in a file.

    Where RETUNER_DEMO names the folder that `make demo` has left, and .txt beside it what it printed, that is the run.
    """
    shutil.copytree(ROOT / "examples", folder / "examples", ignore=shutil.ignore_patterns("__pycache__"))
    demo = os.environ.get("RETUNER_DEMO")
    if demo:
        shutil.copytree(demo, folder / "runs" / "oven")
        told, status = Path(f"{demo}.txt").read_text(encoding="utf-8").replace(DEMO, "runs/oven"), 0
    else:
        told, status = _run(Block("sh", f"retuner {OVEN}\n", "", None, 0), folder)
    if status:
        raise RuntimeError(f"retuner {OVEN}: status {status}\n{told}")
    (folder / "printed").write_text(told, encoding="utf-8")


def copying(oven: Path) -> str:
    """Before a block of sh: what make_oven left in a folder stands for the run of the oven."""
    there = shlex.quote(str(oven))
    return f"""retuner() {{
    if [ "$*" = "{OVEN}" ]; then mkdir -p runs; cp -r {there}/runs/oven runs/; cat {there}/printed
    else command retuner "$@"; fi
}}
"""


@contextmanager
def alone() -> Iterator[None]:
    """One at a time: sessions over udp_multicast on one machine hear one another."""
    with (Path(tempfile.gettempdir()) / "retuner-pages.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def background() -> Iterator[list[subprocess.Popen[bytes]]]:
    """What goes on beside the blocks is stopped at the end."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        yield started
    finally:
        for process in started:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()


def _run(block: Block, folder: Path, before: str = "") -> tuple[str, int]:
    done = subprocess.run(
        _command(block, before),
        cwd=folder,
        env=_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    return "".join(f"{line.rstrip()}\n" for line in done.stdout.splitlines()), done.returncode


def _command(block: Block, before: str = "") -> list[str]:
    return [sys.executable, "-c", block.code] if block.kind == "python" else ["bash", "-e", "-c", before + block.code]


def _environment() -> dict[str, str]:
    """Programs of this environment first, no colours, lines of one width, one thread for linear algebra."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    fixed = {"PATH": path, "COLUMNS": WIDTH, "NO_COLOR": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    return {name: value for name, value in os.environ.items() if name != "RETUNER_TESTS"} | fixed


def agrees(printed: str, came: str) -> bool:
    """Whether what came is what the page prints."""
    return _agree(tuple(printed.strip("\n").splitlines()), tuple(came.strip("\n").splitlines()))


def _agree(told: tuple[str, ...], came: tuple[str, ...]) -> bool:
    if not told:
        return not came
    if told[0].strip() == "...":
        return any(_agree(told[1:], came[skipped:]) for skipped in range(len(came) + 1))
    return bool(came) and same_line(told[0], came[0]) and _agree(told[1:], came[1:])


def same_line(told: str, came: str) -> bool:
    """Words are the same, numbers nearly so, `...` is anything."""
    parts = []
    for piece in re.split(r"(\.\.\.)", told.strip()):
        texts = NUMBER.split(piece)
        parts.append(".*" if piece == "..." else NUMBER.pattern.join(_spaced(text) for text in texts))
    pattern = "".join(parts).replace(NUMBER.pattern, f"({NUMBER.pattern})")
    found = re.fullmatch(pattern, came.strip(), re.IGNORECASE)
    numbers = [number for piece in told.split("...") for number in NUMBER.findall(piece)]
    return found is not None and all(map(near, numbers, found.groups()))


def _spaced(text: str) -> str:
    return r"\s+".join(map(re.escape, re.split(r"\s+", text)))


def near(told: str, came: str) -> bool:
    """Equal but for a per cent or a last digit."""
    a, b = float(told), float(came)
    digits = told.partition("e")[0].partition(".")[2]
    return abs(a - b) <= max(TOLERANCE * abs(a), 1.01 * 10.0 ** -len(digits) if digits else 0.0)


def rewritten(text: str, block: Block, came: str) -> str:
    """The page with what came now; where lines were left out, it tells as many of the first and the last ones again."""
    told, lines = (block.printed or "").splitlines(), came.rstrip("\n").splitlines()
    gaps = [number for number, line in enumerate(told) if line.strip() == "..."]
    if gaps:
        last = len(told) - 1 - gaps[-1]
        lines = [*lines[: gaps[0]], "...", *(lines[-last:] if last else [])]
    old = f"```{block.kind}\n{block.code}```\n\n```text\n"
    new = "".join(f"{line}\n" for line in lines)
    return text.replace(f"{old}{block.printed}", f"{old}{new}", 1)


def main() -> int:
    """Run the pages; 1 when something differs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--write", action="store_true", help="put what comes now in place of what stood there")
    options = parser.parse_args()
    return 1 if sum([_tell(page.resolve(), write=options.write) for page in options.pages or pages()]) else 0


def _tell(page: Path, *, write: bool) -> int:
    """Run one page and say what differs; how many blocks did."""
    text, wrong = page.read_text(encoding="utf-8"), 0
    with tempfile.TemporaryDirectory(prefix="retuner-page-") as folder:
        for block, came, status in run_page(page, Path(folder), oven_here):
            differs = block.printed is not None and not agrees(block.printed, came)
            if status != block.status or differs:
                wrong += 1
                sys.stdout.write(f"{page.name}:{block.line}: status {status}\n{block.code}--- came\n{came}\n")
            if differs and write:
                text = rewritten(text, block, came)
    if write:
        page.write_text(text, encoding="utf-8")
    return wrong


if __name__ == "__main__":
    sys.exit(main())
