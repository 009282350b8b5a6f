"""What a run leaves in its folder: config.toml (as it was run), ledger.sqlite, bus.blf, trend, gains.toml,
summary.json and report.html; live-1.bin, where it can be watched from outside; on a real bus memory.json
(memory_file.py); and orders/, into which people's orders to it are put (orders.py).

A session of several loops has a folder for each of them in loops/, with the loop's trend, gains, report, memory and
orders. Configuration, ledger, bus logs, summary and a report that leads to theirs stand in the session's own folder.

A folder that holds an earlier run is moved aside under a number, never written over: a ledger is evidence.
"""

import contextlib
import hashlib
import platform
import re
from collections.abc import Collection, Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from retuner import adaptive, drivers, schedule
from retuner.adaptive.fit.engine import engine_name
from retuner.adaptive.supervision.decision import Mode
from retuner.config.loading import load_session, text_as_run
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig, folder_name
from retuner.errors import LedgerError, UserError
from retuner.files import sync_folder
from retuner.ledger import LedgerReader, Row
from retuner.ledger.lock import WriterLock
from retuner.schedule.late_dataclass import dataclass, replace

LEDGER, REPORT, SUMMARY, GAINS, BUS_LOG, TREND, CONFIG = (
    "ledger.sqlite", "report.html", "summary.json", "gains.toml", "bus.blf", "trend", "config.toml",
)  # fmt: skip
MEMORY, MEMORY_BEFORE, MEMORY_START = "memory.json", "memory-before.json", "memory-start.json"
ORDERS = "orders"
LIVE = "live"
LOOPS = "loops"
LOG_NAME = re.compile(r"(?:pretune-)?bus(?:_[0-9]+)?(?:-[0-9]+)?\.blf")  # Logs of buses and their parts
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

    Raises UserError: the path is a file, a folder that holds something else than a run of ours, or one in which a run
    is under way.
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
                folder = fresh.path / LOOPS
                for loop in folder.iterdir():
                    for name in (MEMORY, MEMORY_BEFORE, MEMORY_START):
                        (loop / name).unlink(missing_ok=True)
                    loop.rmdir()
                folder.rmdir()
        finally:
            lock.close()
        fresh.path.rmdir()
        if fresh.moved is not None:
            fresh.moved.rename(fresh.path)
            return
        for path in fresh.made[1:]:
            path.rmdir()


# ---- A session's folder, read again: its configuration as run, and the rows of its ledger, believed before they
# are used.
#
# Whatever is missing, cut off or changed afterwards is told in one line: a session is evidence, or it is none.


@dataclass(frozen=True, slots=True)
class RecordedSession:
    """A session of one loop, or one loop of a session, as it stands in its folder.

    folder : of the loop. config : as run. mode : what the command line had said, None when nothing. rows : of the
    ledger that are about this loop, chain verified. bus_log : of its traffic, or the newest part of it (log_parts()
    gives all). name : of the loop where there are several, else empty.
    """

    folder: Path
    config: Config
    mode: Mode | None
    rows: tuple[Row, ...]
    bus_log: Path
    name: str = ""

    @property
    def versions(self) -> Mapping[str, str]:
        """What it was made with."""
        recorded: Mapping[str, str] = self.rows[0].body.get("versions", {})
        return recorded

    @property
    def end(self) -> Mapping[str, Any] | None:
        """The row that closed the session; None when it was killed, or goes on."""
        return self.rows[-1].body if self.rows[-1].kind == "end" else None

    @property
    def bus_log_sha256(self) -> str | None:
        """Hash of the bus log as the session's end has it; None while nothing is known."""
        logs: Mapping[str, str] = (self.end or {}).get("bus_logs", {})
        return logs.get(self.bus_log.name, (self.end or {}).get("bus_log_sha256"))


def ledger_path(session: Path) -> Path:
    """The ledger of a session given by its folder or by the ledger itself. Raises UserError: there is none."""
    path = session / LEDGER if session.is_dir() else session
    if not path.is_file():
        what = f"holds no {LEDGER}" if session.is_dir() else "no such folder or ledger"
        of_loops = session.resolve().parent.parent
        if session.is_dir() and (of_loops / LEDGER).is_file():
            where = f"the ledger of all loops is in {of_loops}: give that with --loop"
        else:
            where = "give the folder that a run has left"
        raise UserError(f"{session}: {what}; {where}")
    return path


def believed_rows(path: Path) -> tuple[Row, ...]:
    """All rows of a ledger.

    Raises LedgerError: it cannot be read, or its chain is broken: the line names the row and what is wrong with it.
    """
    with LedgerReader(path) as ledger:
        report = ledger.verify()
        if not report.ok:
            raise LedgerError(f"{path}: broken: {report.reason}; {report.rows} rows before it hold")
        return tuple(row for row in ledger.rows() if row.seq <= report.rows)


def rows_by_loop(rows: Iterable[Row], names: Collection[str]) -> dict[str, tuple[Row, ...]]:
    """The rows about each of these loops; those that name none are about all."""
    found: dict[str, list[Row]] = {name: [] for name in names}
    for row in rows:
        named = row.body.get("loop")
        for name, about in found.items():
            if named in {None, name}:
                about.append(row)
    return {name: tuple(about) for name, about in found.items()}


def read_loops(session: Path) -> tuple[tuple[RecordedSession, ...], SessionConfig]:
    """Every loop of a session, in the order of its configuration, which comes with them, but not the bus log.

    Raises UserError: something is missing or was changed after the run.
    """
    path = ledger_path(session)
    folder = path.parent
    rows = believed_rows(path)
    if not rows or rows[0].kind != "session" or "config_sha256" not in rows[0].body:
        raise UserError(f"{path}: is not the ledger of a session of `retuner run` of this release")
    first = rows[0].body
    config, text = load_session(folder / CONFIG)
    if hashlib.sha256(text.encode()).hexdigest() != first["config_sha256"]:
        raise UserError(f"{folder / CONFIG}: was changed after the run; the ledger has another hash for it")
    given = first["overrides"].get("adaptation.mode")
    mode = Mode(given) if given else None
    about = rows_by_loop(rows, config.names) if config.several else {config.names[0]: rows}
    buses = {i: number for number, loops in enumerate(config.buses) for i in loops}
    recorded = []
    for i, (name, one) in enumerate(zip(config.names, config.loops, strict=True)):
        own = name if config.several else ""
        log = log_of_bus(folder / BUS_LOG, buses[i])
        recorded.append(RecordedSession(loop_folder(folder, own), one, mode, about[name], log, own))
    return tuple(recorded), config


# ---- What a run was made with: enough to do it again, and to say for which versions byte identity may be claimed.
#
# The same frames give the same decisions byte for byte where all of this is equal: linear algebra libraries round
# differently from release to release and from processor to processor.

ROOMS = (schedule, adaptive, drivers)  # the code that lies between frames and decisions
PACKAGES = ("retuner", "numpy", "scipy", "filterpy", "python-can", "cantools")
"""What the way from frames to decisions goes through."""
BLOCK = 1 << 20  # bytes read at a time


def versions() -> dict[str, str]:
    """Versions of everything between frames and decisions, by name; code: a hash of the rooms' own, which tells more
    than the number of a release; engine: which one computes the fits, they are equal to rounding and not to the bit.
    """
    return {
        **{name: version(name) for name in PACKAGES},
        "engine": engine_name(),
        "code": code(),
        "python": platform.python_version(),
        "system": platform.system(),
        "machine": platform.machine(),
    }


def code() -> str:
    """The first 12 digits of a SHA-256 over the source of the rooms."""
    digest = hashlib.sha256()
    for room in ROOMS:
        folder = Path(next(iter(room.__path__)))
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def differences(recorded: Mapping[str, str]) -> list[str]:
    """Which versions are others here, in words; empty when all are equal."""
    here = versions()
    return [
        f"{name} {recorded.get(name, 'none')} then, {here.get(name, 'none')} here"
        for name in sorted({*recorded, *here})
        if recorded.get(name) != here.get(name)
    ]


def session_identity(
    session: SessionConfig, text: str, changes: Mapping[tuple[str, str], str | bool]
) -> tuple[str, dict[str, object]]:
    """The configuration as it is run, as text, and what a session's first row says of all that it is made with.

    session : as read, with the bus that is meant. text : as its author wrote it. changes : (section, key) to its value,
    as the command line has it.
    """
    in_mode = []
    for one in session.loops:
        mode = changes.get(("adaptation", "mode"), one.adaptation.mode)
        in_mode.append(one.model_copy(update={"adaptation": one.adaptation.model_copy(update={"mode": mode})}))
    text = text_as_run(text, replace(session, loops=tuple(in_mode)), changes)
    seeds = [one.device.seed if one.device else None for one in session.loops]
    return text, {
        "versions": versions(),
        "seed": seeds if session.several else seeds[0],
        "config_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "overrides": {".".join(place): value for place, value in changes.items()},
    }


def file_sha256(*paths: Path) -> str | None:
    """SHA-256 of a file, or of several one after the other; None when one cannot be read."""
    digest = hashlib.sha256()
    try:
        for path in paths:
            with path.open("rb") as stream:
                while block := stream.read(BLOCK):
                    digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()
