"""Which sessions and loops there are to be seen: those of one folder that a run leaves, or of a folder of such folders.

A loop is named by its session's folder and its number there: "demo/1". A session that begins anew in the same folder is
another one: its files are other files, which is looked for every few seconds.
"""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from retuner.errors import LedgerError, UserError
from retuner.live_view.live_file import LiveFileError, LiveReader
from retuner.serve.ledger_tail import LedgerTail
from retuner.session.outputs import LEDGER, is_live_file, loop_folder

NOBODY_S = 1e9  # the age of what is not there
MOST_SESSIONS = 64  # sessions that are shown, the newest ones


class WatchedLoop:
    """A loop that can be seen. key : as the page names it."""

    def __init__(self, key: str, path: Path) -> None:
        self.key, self.path = key, path
        self.reader = LiveReader(path)
        self._inode = path.stat().st_ino
        self.following = self.reader.counts()[0]

    @property
    def name(self) -> str:
        """The loop's name in its configuration."""
        return str(self.reader.head.get("loop", ""))

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of its regions."""
        return tuple(map(str, self.reader.head.get("regions", ())))

    def order_folder(self, session: Path) -> Path:
        """Where orders to this loop are put, below its session's folder."""
        return loop_folder(session, self.name if self.reader.head.get("several") else "")

    def age_s(self) -> float:
        """How long ago anything was written, by the machine's clock."""
        try:
            return max(time.time() - self.path.stat().st_mtime, 0.0)
        except OSError:
            return NOBODY_S

    @property
    def there(self) -> bool:
        """Whether the file still has its name."""
        return _is_still(self.path, self._inode)


def _is_still(path: Path, inode: int) -> bool:
    try:
        return path.stat().st_ino == inode
    except OSError:
        return False


class WatchedSession:
    """A session: its ledger, and its loops by key. Raises LedgerError: its ledger cannot be read."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.resolve().name
        self.ledger = LedgerTail(folder / LEDGER)
        self._inode = (folder / LEDGER).stat().st_ino
        self.loops: dict[str, WatchedLoop] = {}

    @property
    def there(self) -> bool:
        """Whether the same session is still in its folder."""
        return _is_still(self.folder / LEDGER, self._inode)

    def look(self) -> None:
        """Find the loops that have appeared."""
        for path in sorted(self.folder.glob("live-*.bin")):
            key = f"{self.name}/{path.stem.partition('-')[2]}"
            if is_live_file(path) and key not in self.loops:
                with contextlib.suppress(LiveFileError, OSError):  # half made: the next look finds it whole
                    self.loops[key] = WatchedLoop(key, path)

    def close(self) -> None:
        """Close all files."""
        self.ledger.close()
        for loop in self.loops.values():
            loop.reader.close()


class RecordedRuns:
    """The sessions under a folder.

    root : the folder of a session, or of sessions.

    Raises UserError: there is no such folder, or no session in it; or its ledger is of another version.
    """

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            raise UserError(f"{root}: there is no such folder; give the folder of a run, or of several runs")
        self.root = root
        self.sessions: dict[str, WatchedSession] = {}
        self.refused: dict[str, str] = {}
        if not list(self._folders()):
            raise UserError(f"{root}: holds no session; give the folder that `retuner run` leaves or fills")
        self.look()
        if not self.sessions:
            raise UserError(next(iter(self.refused.values())))

    def look(self) -> None:
        """Find what has appeared or gone."""
        for name, session in list(self.sessions.items()):
            if not session.there:
                session.close()
                del self.sessions[name]
        for folder in self._folders():
            name = folder.resolve().name
            if name not in self.sessions:
                try:
                    self.sessions[name] = WatchedSession(folder)
                except LedgerError as error:
                    self.refused[name] = str(error)
        for session in self.sessions.values():
            session.look()

    def loop(self, key: str) -> tuple[WatchedSession, WatchedLoop] | None:
        """A loop by its key, with its session."""
        session = self.sessions.get(key.partition("/")[0])
        loop = session.loops.get(key) if session else None
        return (session, loop) if session and loop else None

    def loops(self) -> Iterator[WatchedLoop]:
        """Every loop."""
        for session in self.sessions.values():
            yield from session.loops.values()

    def close(self) -> None:
        """Close all files."""
        for session in self.sessions.values():
            session.close()

    def _folders(self) -> list[Path]:
        if (self.root / LEDGER).is_file():
            return [self.root]
        with contextlib.suppress(OSError):
            found = [path for path in self.root.iterdir() if (path / LEDGER).is_file()]
            return sorted(found, key=lambda path: -path.stat().st_mtime)[:MOST_SESSIONS]
        return []
