"""A session's folder, read again: its configuration as run, and the rows of its ledger, believed before they are used.

Whatever is missing, cut off or changed afterwards is told in one line: a session is evidence, or it is none.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from retuner.adaptive.supervision.decision import Mode
from retuner.config.loading import load_with_text
from retuner.config.model import Config
from retuner.errors import LedgerError, UserError
from retuner.ledger import LedgerReader, Row
from retuner.session.outputs import BUS_LOG, CONFIG, LEDGER

ROW_KEYS = ("samples",)
"""Keys that a session adds to the body of each row: the number of samples that had been seen."""


@dataclass(frozen=True, slots=True)
class RecordedSession:
    """A session as it stands in its folder.

    config : as run. mode : what the command line had said, None when nothing. rows : of the ledger, chain verified.
    """

    folder: Path
    config: Config
    mode: Mode | None
    rows: tuple[Row, ...]

    @property
    def bus_log(self) -> Path:
        """The log of bus traffic, or its newest part; log_parts() gives all of them."""
        return self.folder / BUS_LOG

    @property
    def versions(self) -> Mapping[str, str]:
        """What it was made with."""
        recorded: Mapping[str, str] = self.rows[0].body.get("versions", {})
        return recorded

    @property
    def end(self) -> Mapping[str, Any] | None:
        """The row that closed the session; None when it was killed, or goes on."""
        return self.rows[-1].body if self.rows[-1].kind == "end" else None


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
        raise UserError(f"{session}: {what}; give the folder that a run has left")
    return path


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


def read_session(session: Path) -> RecordedSession:
    """A session with everything that it is replayed from, but the bus log.

    Raises
    ------
    UserError
        Something is missing or was changed after the run.
    """
    path = ledger_path(session)
    folder = path.parent
    rows = believed_rows(path)
    if not rows or rows[0].kind != "session" or "config_sha256" not in rows[0].body:
        raise UserError(f"{path}: is not the ledger of a session of `retuner run` of this release")
    first = rows[0].body
    config, text = load_with_text(folder / CONFIG)
    if hashlib.sha256(text.encode()).hexdigest() != first["config_sha256"]:
        raise UserError(f"{folder / CONFIG}: was changed after the run; the ledger knows it by another hash")
    mode = first["overrides"].get("adaptation.mode")
    return RecordedSession(folder, config, Mode(mode) if mode else None, rows)


def without_place(body: Mapping[str, Any]) -> dict[str, Any]:
    """The body of a row as it was given, without its place in the order of samples."""
    return {key: value for key, value in body.items() if key not in ROW_KEYS}


def canonical(decision: Mapping[str, Any]) -> bytes:
    """A decision's plain values as Decision.canonical() has them."""
    return json.dumps(decision, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
