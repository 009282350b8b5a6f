"""The ledger's SQLite file: tables, guards, version, and how it is opened.

WAL so that others read while one writes; synchronous=FULL because NORMAL loses acknowledged rows at a power cut
(measured). Triggers refuse every change but the next row; they stop mistakes, and the hash chain shows the rest.
"""

import sqlite3
from pathlib import Path

from retuner.errors import LedgerError

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

    Raises
    ------
    LedgerError
        It cannot be opened, or is no ledger of this version.
    """
    if path.is_file() and 0 < path.stat().st_size < SMALLEST:  # SQLite would take it for empty and write over it
        raise LedgerError(f"{path}: {NO_DATABASE}")
    connection = None
    try:
        connection = sqlite3.connect(
            f"{path.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None, timeout=BUSY_TIMEOUT_S
        )
        connection.text_factory = _as_text
        connection.execute(f"PRAGMA synchronous = {FULL}")
        if _pragma(connection, "synchronous") != FULL:
            raise sqlite3.OperationalError("it does not take synchronous = FULL, without which a power cut loses rows")
        if mode == "rwc":
            _create(connection)
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


def _as_text(raw: bytes) -> str:
    """Text of a column; bytes that are no UTF-8 stay visible to the hash check instead of stopping the reading."""
    return raw.decode("utf-8", errors="surrogateescape")


def _create(connection: sqlite3.Connection) -> None:
    """Lay the tables into an empty file, all or nothing; a file that has content already stays as it is."""
    if _pragma(connection, "schema_version") != 0:
        return
    connection.execute("PRAGMA journal_mode = WAL").fetchone()  # an error of the disk comes with the row
    marks = f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {VERSION};"
    connection.executescript(f"BEGIN IMMEDIATE; {marks} {TABLES} COMMIT;")


def _check_version(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse a file of another program or another version.

    Raises
    ------
    LedgerError
        Saying which.
    """
    application, version = _pragma(connection, "application_id"), _pragma(connection, "user_version")
    if not application and _pragma(connection, "schema_version") == 0:
        raise LedgerError(f"{path}: holds nothing: the run that made it was ended before its first row")
    if application != APPLICATION_ID:
        raise LedgerError(f"{path}: is an SQLite file of another program, not a ledger; give another path")
    if version != VERSION:
        raise LedgerError(f"{path}: is a ledger of version {version}; this release reads version {VERSION}")
