"""One writer per ledger: a lock on LEDGER.lock that the system lets go of when its process dies, however it dies.

On POSIX flock(2) on a file of its own. Not on the ledger itself: closing any handle of a file drops all of a process's
POSIX locks on it, SQLite's among them. The file is taken away at the end, while the lock is still held; so whoever
locked it must look whether what it locked still has the name, or it would hold a lock that nobody else can see. Where
there is no flock (Windows) SQLite's own lock serves, and a file that another process has open cannot be taken away.
"""

import contextlib
import os
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path

from retuner.errors import LedgerError

ATTEMPTS = 100  # each one fails only when another writer ended at this very moment


class WriterLock:
    """Hold the lock of the ledger at path until close().

    Raises LedgerError: another process holds it, or the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        lock = path.with_name(path.name + ".lock")
        try:
            self._release = _take(lock)
        except BlockingIOError:
            raise LedgerError(f"{path}: another run writes this ledger; end it or give another path") from None
        except (OSError, sqlite3.Error) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise LedgerError(f"{path}: cannot be locked for writing: {reason}") from None

    def close(self) -> None:
        """Let go; more than once does no harm."""
        release, self._release = self._release, lambda: None
        release()


if sys.platform == "win32":

    def _take(lock: Path) -> Callable[[], None]:
        connection = sqlite3.connect(lock, isolation_level=None, timeout=0)
        try:
            connection.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            connection.close()
            if error.sqlite_errorcode == sqlite3.SQLITE_BUSY:
                raise BlockingIOError from None
            raise

        def release() -> None:
            connection.close()
            with contextlib.suppress(OSError):  # another process has opened it: it stays
                lock.unlink()

        return release

else:
    import fcntl

    def _take(lock: Path) -> Callable[[], None]:
        """flock on a file that still has its name; what lets go of it."""
        for _ in range(ATTEMPTS):
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                named = os.path.samestat(os.fstat(handle), lock.stat())
            except FileNotFoundError:
                named = False
            except OSError:
                os.close(handle)
                raise
            if named:
                break
            os.close(handle)
        else:
            raise BlockingIOError

        def release() -> None:
            """Take the file away first: whoever opens it now makes a new one or finds that it has lost its name."""
            with contextlib.suppress(OSError):  # a folder that has become read-only keeps it; it does no harm
                lock.unlink()
            os.close(handle)

        return release
