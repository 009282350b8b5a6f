"""The ledger: an append-only, hash-chained record on disk. A row is durable before `append` returns.

Time is an argument (clock_s), so a run in simulated time gives the same hashes each time.
"""

import contextlib
import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from retuner.errors import LedgerError
from retuner.files import sync_folder
from retuner.ledger.canonical import canonical_json
from retuner.ledger.chain import ChainReport, Row, check_chain, next_row
from retuner.ledger.lock import WriterLock
from retuner.ledger.schema import READING_ERRORS, connect

BUSY_TRIES = 24
"""Times that a row waits schema.BUSY_TIMEOUT_S for another process's lock, 120 s in all: the controller goes on by
itself meanwhile, and a backup or a careless reader is over by then."""


class Recorder(Protocol):
    """Keeps rows for good before it returns: the ledger, seen from a loop under supervision."""

    def __call__(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """Record one row."""
        ...


class LedgerReader:
    """A ledger to read, also while another process writes it.

    Raises
    ------
    LedgerError
        The file does not exist, or is no ledger of this version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise LedgerError(f"{path}: no such ledger file")
        self._connection = connect(self.path, "ro")

    def rows(self) -> Iterator[Row]:
        """All rows in order, as they stand in the file, believed or not; `verify` says which."""
        query = "SELECT seq, clock_s, kind, body, previous, hash FROM ledger ORDER BY seq"
        try:
            yield from (Row(*columns) for columns in self._connection.execute(query))
        except READING_ERRORS as error:
            raise LedgerError(f"{self.path}: cannot be read: {error}") from None

    def rows_after(self, seq: int, most: int) -> list[Row]:
        """At most so many rows after this one, in order, as they stand in the file; the file is let go of at once."""
        query = "SELECT seq, clock_s, kind, body, previous, hash FROM ledger WHERE seq > ? ORDER BY seq LIMIT ?"
        try:
            return [Row(*columns) for columns in self._connection.execute(query, (seq, most)).fetchall()]
        except READING_ERRORS as error:
            raise LedgerError(f"{self.path}: cannot be read: {error}") from None

    def head(self) -> str:
        """Hash of the last row, 64 hexadecimal digits; zeros for an empty ledger."""
        return self._head()[1]

    def size_bytes(self) -> int:
        """Size of the file with what SQLite keeps beside it, bytes; 0 for what cannot be looked at."""
        total = 0
        for path in (self.path, self.path.with_name(f"{self.path.name}-wal")):
            with contextlib.suppress(OSError):
                total += path.stat().st_size
        return total

    def verify(self, anchor: str = "") -> ChainReport:
        """Recompute the whole chain and name the first row that cannot be believed.

        Parameters
        ----------
        anchor : the hash of a row, or its beginning, that was noted elsewhere: whoever can write the file can cut off
            its last rows and set its head back, and only a note outside of the file shows that.

        Raises
        ------
        LedgerError
            The file cannot be read as SQLite at all.
        """
        return check_chain(self.rows(), self._head(), anchor)

    def _head(self) -> tuple[int, str]:
        try:
            found: tuple[int, str] | None = self._connection.execute("SELECT seq, hash FROM head").fetchone()
        except READING_ERRORS as error:
            raise LedgerError(f"{self.path}: cannot be read: {error}") from None
        if found is None:
            raise LedgerError(f"{self.path}: its head is missing; the file was tampered with")
        return found[0], str(found[1])  # damaged, it may be of any type

    def close(self) -> None:
        """Close the file; more than once does no harm."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


class Ledger(LedgerReader):
    """A ledger to write; the file is made when it does not exist. One process writes at a time.

    Raises
    ------
    LedgerError
        The folder does not exist, the file is no ledger of this version, another process writes it, or its chain is
        broken (a broken ledger stays as evidence; begin a new one).
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.parent.is_dir():
            raise LedgerError(f"{path}: the folder {self.path.parent} does not exist; make it first")
        self._lock = WriterLock(self.path)
        try:
            self._connection = connect(self.path, "rwc")
            sync_folder(self.path.parent)  # a new file's name must outlast a power cut as its rows do
            report = self.verify()
        except LedgerError:
            self._lock.close()
            raise
        if not report.ok:
            self.close()
            raise LedgerError(f"{path}: {report.reason}; keep the file as evidence and give another path")
        self._last, self._seq = report.head, report.rows
        self._failed = ""

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """The same as Ledger(path)."""
        return cls(path)

    def append(self, kind: str, body: Mapping[str, object], clock_s: float) -> Row:
        """Write a row; it is on disk when this returns.

        Parameters
        ----------
        kind : what the row is, for example "decision". body : JSON values, finite numbers only.
        clock_s : time of the run's clock in seconds, finite.

        Raises
        ------
        ValueError
            The body or clock_s has no canonical JSON; nothing was written.
        LedgerError
            The disk refused. After that the object refuses every row: what is on disk is known only by opening anew.
        """
        if self._failed:
            raise LedgerError(f"{self.path}: refused, because an earlier row failed ({self._failed}); open it anew")
        row = next_row(self._last, self._seq + 1, clock_s, kind, canonical_json(body))
        try:
            self._insert(row)
        except sqlite3.Error as error:
            self._failed = str(error)
            raise LedgerError(f"{self.path}: row {row.seq} cannot be written: {error}") from None
        self._last, self._seq = row.hash, row.seq
        return row

    def _insert(self, row: Row) -> None:
        """The row, once whoever else has locked the file lets go of it: as long as it is locked nothing is written."""
        columns = (row.seq, row.clock_s, row.kind, row.text, row.previous, row.hash)
        for tries_left in reversed(range(BUSY_TRIES)):
            try:
                self._connection.execute("INSERT INTO ledger VALUES (?, ?, ?, ?, ?, ?)", columns)
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or not tries_left:
                    raise
            else:
                return

    def close(self) -> None:
        """Close the file and let another process write; more than once does no harm.

        SQLite empties the WAL into the file when the last one closes it. A reader may stay, so it is done here: the
        file by itself has every row, and nobody is waited for.
        """
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        super().close()
        self._lock.close()
