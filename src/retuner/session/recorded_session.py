"""A session's folder, read again: its configuration as run, and the rows of its ledger, believed before they are used.

Whatever is missing, cut off or changed afterwards is told in one line: a session is evidence, or it is none.
"""

import hashlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from retuner.adaptive.supervision.decision import Mode
from retuner.config.loading import load_session
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig
from retuner.errors import LedgerError, UserError
from retuner.ledger import LedgerReader, Row
from retuner.session.outputs import BUS_LOG, CONFIG, LEDGER, log_of_bus, loop_folder


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
    """The ledger of a session given by its folder or by the ledger itself.

    Raises
    ------
    UserError
        There is none.
    """
    path = session / LEDGER if session.is_dir() else session
    if not path.is_file():
        what = f"holds no {LEDGER}" if session.is_dir() else "no such folder or ledger"
        raise UserError(f"{session}: {what}; {_where(session)}")
    return path


def _where(session: Path) -> str:
    """What to give in place of a folder without a ledger: several loops share the one of their run."""
    of_loops = session.resolve().parent.parent
    if session.is_dir() and (of_loops / LEDGER).is_file():
        return f"the ledger of all loops is in {of_loops}: give that with --loop"
    return "give the folder that a run has left"


def believed_rows(path: Path) -> tuple[Row, ...]:
    """All rows of a ledger.

    Raises
    ------
    LedgerError
        It cannot be read, or its chain is broken: the line names the row and what is wrong with it.
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


def read_session(session: Path, loop: str | None = None) -> RecordedSession:
    """A session with everything that it is replayed from, but the bus log.

    loop : the name of one of several loops.

    Raises
    ------
    UserError
        Something is missing or was changed after the run, there is no such loop, or there are several and none is
        named.
    """
    loops, config = read_loops(session)
    return loops[config.place(loop)]


def read_loops(session: Path) -> tuple[tuple[RecordedSession, ...], SessionConfig]:
    """Every loop of a session, in the order of its configuration, which comes with them; errors as read_session."""
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
