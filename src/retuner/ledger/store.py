"""The ledger: an append-only, hash-chained record on disk. A row is durable before `append` returns.

Time is an argument (clock_s), so a run in simulated time gives the same hashes each time.

The ledger's SQLite file: tables, guards, version, and how it is opened.

WAL so that others read while one writes; synchronous=FULL because NORMAL loses acknowledged rows at a power cut
(measured). Triggers refuse every change but the next row; they stop mistakes, and the hash chain shows the rest.
"""

import contextlib
import sqlite3
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

from retuner.drivers.closing import Closes
from retuner.errors import LedgerError
from retuner.files import sync_folder
from retuner.ledger.chain import ChainReport, Row, canonical_json, check_chain, next_row
from retuner.ledger.lock import WriterLock

# ---- The ledger's SQLite file

APPLICATION_ID = 0x72746E72  # "rtnr", at byte 68 of the file
VERSION = 1
READING_ERRORS = (sqlite3.Error, UnicodeDecodeError)  # the second: a message of SQLite's about damaged text
SMALLEST = 512  # bytes; SQLite's smallest page, so no database is smaller
NO_DATABASE = "is not a database, so not a ledger; give another path"
FULL = 2  # SQLite's synchronous: a row is flushed to the disk before it is acknowledged
BUSY_TIMEOUT_S = 5.0  # longest wait for another process's short lock (a checkpoint, a reader that recovers the WAL)

TABLES = """
CREATE TABLE ledger (
  seq INTEGER PRIMARY KEY, clock_s REAL NOT NULL, kind TEXT NOT NULL, body TEXT NOT NULL,
  previous TEXT NOT NULL, hash TEXT NOT NULL UNIQUE
);
CREATE TABLE head (one INTEGER PRIMARY KEY CHECK (one = 1), seq INTEGER NOT NULL, hash TEXT NOT NULL);
INSERT INTO head VALUES (1, 0, '0000000000000000000000000000000000000000000000000000000000000000');
CREATE TRIGGER no_update BEFORE UPDATE ON ledger BEGIN SELECT RAISE(ABORT, 'the ledger is append-only'); END;
CREATE TRIGGER no_delete BEFORE DELETE ON ledger BEGIN SELECT RAISE(ABORT, 'the ledger is append-only'); END;
CREATE TRIGGER only_next BEFORE INSERT ON ledger
  WHEN NEW.seq IS NOT (SELECT seq + 1 FROM head) OR NEW.previous IS NOT (SELECT hash FROM head)
  BEGIN SELECT RAISE(ABORT, 'a row must follow the last one'); END;
CREATE TRIGGER move_head AFTER INSERT ON ledger BEGIN UPDATE head SET seq = NEW.seq, hash = NEW.hash; END;
CREATE TRIGGER head_follows BEFORE UPDATE ON head
  WHEN NOT EXISTS (SELECT 1 FROM ledger WHERE seq = NEW.seq AND hash = NEW.hash AND NEW.seq = OLD.seq + 1)
  BEGIN SELECT RAISE(ABORT, 'the head moves with the ledger only'); END;
CREATE TRIGGER head_stays BEFORE DELETE ON head BEGIN SELECT RAISE(ABORT, 'the head stays'); END;
"""


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open the file with manual transactions. mode : "ro", "rw" or "rwc", as SQLite's URI has it.

    Nothing here opens the file beside SQLite, not even for a look at its first bytes: closing that handle would drop
    the locks of a writer in this process, and another process that reads would then take the writer's WAL away.

    Raises LedgerError: it cannot be opened, or is no ledger of this version.
    """
    if path.is_file() and 0 < path.stat().st_size < SMALLEST:  # SQLite would take it for empty and write over it
        raise LedgerError(f"{path}: {NO_DATABASE}")
    connection = None
    try:
        connection = sqlite3.connect(
            f"{path.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None, timeout=BUSY_TIMEOUT_S
        )
        # bytes that are no UTF-8 stay visible to the hash check instead of stopping the reading
        connection.text_factory = lambda raw: raw.decode("utf-8", errors="surrogateescape")
        connection.execute(f"PRAGMA synchronous = {FULL}")
        if _pragma(connection, "synchronous") != FULL:
            raise sqlite3.OperationalError("it does not take synchronous = FULL, without which a power cut loses rows")
        if mode == "rwc" and _pragma(connection, "schema_version") == 0:
            connection.execute("PRAGMA journal_mode = WAL").fetchone()  # an error of the disk comes with the row
            marks = f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {VERSION};"
            connection.executescript(f"BEGIN IMMEDIATE; {marks} {TABLES} COMMIT;")
        _check_version(connection, path)
    except (*READING_ERRORS, LedgerError) as error:
        if connection is not None:
            connection.close()
        if isinstance(error, LedgerError):
            raise
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_NOTADB:
            raise LedgerError(f"{path}: {NO_DATABASE}") from None
        hint = ""
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_CANTOPEN and path.exists():
            hint = "; SQLite must be able to write in its folder, also to read what a killed run left: copy the folder"
        raise LedgerError(f"{path}: cannot be opened as a ledger: {error}{hint}") from None
    return connection


def _pragma(connection: sqlite3.Connection, name: str) -> int:
    """A number in the file's head; SQLite gives no row for it when the file is damaged enough."""
    row: tuple[int] | None = connection.execute(f"PRAGMA {name}").fetchone()
    if row is None:
        raise sqlite3.DatabaseError("its head cannot be read")
    return row[0]


def _check_version(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse a file of another program or another version. Raises LedgerError: saying which."""
    application, version = _pragma(connection, "application_id"), _pragma(connection, "user_version")
    if not application and _pragma(connection, "schema_version") == 0:
        raise LedgerError(f"{path}: holds nothing: the run that made it was ended before its first row")
    if application != APPLICATION_ID:
        raise LedgerError(f"{path}: is an SQLite file of another program, not a ledger; give another path")
    if version != VERSION:
        raise LedgerError(f"{path}: is a ledger of version {version}; this release reads version {VERSION}")


BUSY_TRIES = 24
"""Times that a row waits schema.BUSY_TIMEOUT_S for another process's lock, 120 s in all: the controller goes on by
itself meanwhile, and a backup or a careless reader is over by then."""


class Recorder(Protocol):
    """Keeps rows for good before it returns: the ledger, seen from a loop under supervision."""

    def __call__(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """Record one row."""


class LedgerReader(Closes):
    """A ledger to read, also while another process writes it.

    Raises LedgerError: the file does not exist, or is no ledger of this version.
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
        """The rows after this one, at most so many, in order, as the file has them; it is let go of at once."""
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

        anchor : the hash of a row, or its beginning, that was noted elsewhere: whoever can write the file can cut off
            its last rows and set its head back, and only a note outside of the file shows that.

        Raises LedgerError: the file cannot be read as SQLite at all.
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


class Ledger(LedgerReader):
    """A ledger to write; the file is made when it does not exist. One process writes at a time.

    Raises LedgerError: the folder does not exist, the file is no ledger of this version, another process writes it, or
    its chain is broken (a broken ledger stays as evidence; begin a new one).
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

    def append(self, kind: str, body: Mapping[str, object], clock_s: float) -> Row:
        """Write a row; it is on disk when this returns.

        kind : what the row is, for example "decision". body : JSON values, finite numbers only.
        clock_s : time of the run's clock in seconds, finite.

        Raises ValueError: the body or clock_s has no canonical JSON; nothing was written.
        Raises LedgerError: the disk refused. After that the object refuses every row: what is on disk is known only by
        opening anew.
        """
        if self._failed:
            raise LedgerError(f"{self.path}: refused, because an earlier row failed ({self._failed}); open it anew")
        row = next_row(self._last, self._seq + 1, clock_s, kind, canonical_json(body))
        columns = (row.seq, row.clock_s, row.kind, row.text, row.previous, row.hash)
        for tries_left in reversed(range(BUSY_TRIES)):  # once whoever else has locked the file lets go of it
            try:
                self._connection.execute("INSERT INTO ledger VALUES (?, ?, ?, ?, ?, ?)", columns)
                break
            except sqlite3.Error as error:
                locked = (
                    isinstance(error, sqlite3.OperationalError) and error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_BUSY
                )
                if not locked or not tries_left:
                    self._failed = str(error)
                    raise LedgerError(f"{self.path}: row {row.seq} cannot be written: {error}") from None
        self._last, self._seq = row.hash, row.seq
        return row

    def close(self) -> None:
        """Close the file and let another process write; more than once does no harm.

        SQLite empties the WAL into the file when the last one closes it. A reader may stay, so it is done here: the
        file by itself has every row, and nobody is waited for.
        """
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        super().close()
        self._lock.close()
