"""What a run leaves in its folder: config.toml (as it was run), ledger.sqlite, bus.blf, trend, gains.toml,
summary.json and report.html; live-1.bin, where it can be watched from outside; on a real bus memory.json
(memory_file.py); and orders/, into which people's orders to it are put (orders.py).

A session of several loops has a folder for each of them in loops/, with the loop's trend, gains, report, memory and
orders. Configuration, ledger, bus logs, summary and a report that leads to theirs stand in the session's own folder.

A folder that holds an earlier run is moved aside under a number, never written over: a ledger is evidence.
"""

import contextlib
import re
from pathlib import Path
from typing import NamedTuple

from retuner.config.session_config import folder_name
from retuner.errors import LedgerError, UserError
from retuner.files import sync_folder
from retuner.ledger.lock import WriterLock

LEDGER, REPORT, SUMMARY, GAINS, BUS_LOG, TREND, CONFIG = (
    "ledger.sqlite",
    "report.html",
    "summary.json",
    "gains.toml",
    "bus.blf",
    "trend",
    "config.toml",
)
MEMORY, MEMORY_BEFORE, MEMORY_START = "memory.json", "memory-before.json", "memory-start.json"
ORDERS = "orders"
LIVE = "live"
LOOPS = "loops"
LOG_NAME = re.compile(r"(?:pretune-)?bus(?:_[0-9]+)?(?:-[0-9]+)?\.blf")
"""Logs of buses and their parts."""
REFINED, REFINED_SCHEDULE = "refined.toml", "refined-schedule.toml"
"""A schedule that the records ask for, as a gain table and as the [schedule] of a configuration."""
OURS = {LEDGER, REPORT, SUMMARY, GAINS, REFINED, REFINED_SCHEDULE, BUS_LOG, CONFIG, MEMORY, MEMORY_BEFORE, MEMORY_START}


def loop_folder(session: Path, loop: str) -> Path:
    """The folder of a loop; loop : its name, empty for the only one of a session, whose folder is the session's."""
    return session / LOOPS / folder_name(loop) if loop else session


def log_of_bus(log: Path, number: int) -> Path:
    """The log of a session's bus, from that of its first one: bus.blf, bus_2.blf, ... number : of the bus, from 0."""
    return log.with_name(f"{log.stem}_{number + 1}{log.suffix}") if number else log


def live_file(folder: Path, number: int) -> Path:
    """Where a session's loop of this number, from 1, can be watched from outside (live_view/live_file.py)."""
    return folder / f"{LIVE}-{number}.bin"


def is_live_file(path: Path) -> bool:
    """Whether a file has such a name."""
    return path.name.startswith(f"{LIVE}-") and path.suffix == ".bin"


class FreshFolder(NamedTuple):
    """The folder of a run; where the earlier run in it was moved to; the folders made for it, innermost first."""

    path: Path
    moved: Path | None
    made: tuple[Path, ...]


def fresh_folder(folder: Path) -> FreshFolder:
    """Make an empty folder for a run; an earlier run there is moved to folder-1, folder-2, ...

    Raises
    ------
    UserError
        The path is a file, a folder that holds something else than a run of ours, or one in which a run is under way.
    """
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: is a file; give a folder for the run with --out")
    moved = None
    if folder.is_dir() and any(folder.iterdir()):
        if not any((folder / name).exists() for name in OURS - {CONFIG}):
            raise UserError(f"{folder}: is not empty and holds no earlier run; give another folder with --out")
        if (folder / LEDGER).exists():
            WriterLock(folder / LEDGER).close()  # nobody writes there, or this refuses
        number = 1
        while folder.with_name(f"{folder.name}-{number}").exists():
            number += 1
        moved = folder.with_name(f"{folder.name}-{number}")
        folder.rename(moved)
    made = tuple(path for path in (folder, *folder.parents) if not path.exists())
    folder.mkdir(parents=True, exist_ok=True)
    for path in made:
        sync_folder(path.parent)  # a ledger outlasts a power cut only if its folder does
    return FreshFolder(folder, moved, made)


def give_back(fresh: FreshFolder) -> None:
    """Undo fresh_folder after a run in which nothing happened: our files go, the earlier run comes back.

    What cannot be undone (another run has begun there meanwhile, a disk that refuses) stays.
    """
    with contextlib.suppress(LedgerError, OSError):
        lock = WriterLock(fresh.path / LEDGER)
        try:
            for path in fresh.path.iterdir():
                ours = path.name in OURS or LOG_NAME.fullmatch(path.name) or is_live_file(path)
                if ours or path.name.startswith(f"{LEDGER}-"):
                    path.unlink()
            if (fresh.path / LOOPS).is_dir():
                _clear_loops(fresh.path / LOOPS)
        finally:
            lock.close()
        fresh.path.rmdir()
        if fresh.moved is not None:
            fresh.moved.rename(fresh.path)
            return
        for path in fresh.made[1:]:
            path.rmdir()


def _clear_loops(folder: Path) -> None:
    """Take away what a run that came to nothing had begun in the folders of its loops."""
    for loop in folder.iterdir():
        for name in (MEMORY, MEMORY_BEFORE, MEMORY_START):
            (loop / name).unlink(missing_ok=True)
        loop.rmdir()
    folder.rmdir()
