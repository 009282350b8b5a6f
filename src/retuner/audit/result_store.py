"""The results of an audit as they come: a row a loop in SQLite, whole or not there, so that an audit can go on.

A loop is done when its row carries the signature of its files (names, sizes, times of change), of the settings and of
this program's version; anything else is done again.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

from retuner.audit.catalogue import Task
from retuner.audit.loop_row import SCHEMA, AuditSettings, Row
from retuner.drivers.closing import Closes
from retuner.errors import UserError

NAME = "audit.sqlite"


def signature(task: Task, settings: AuditSettings) -> str:
    """What a row of this task hangs on."""
    files = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in task.files]
    return hashlib.sha256(json.dumps([files, repr(settings), SCHEMA, version("retuner")]).encode()).hexdigest()


class ResultStore(Closes):
    """Rows by tag.

    folder : of the audit; made where it is not there.

    Raises UserError: the folder holds something else under this name, or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._open = sqlite3.connect(folder / NAME)
            self._open.execute("pragma journal_mode = wal")
            self._open.execute("create table if not exists loops (tag text primary key, signature text, row text)")
            self._open.commit()
        except (OSError, sqlite3.Error) as error:
            raise UserError(f"{folder / NAME}: {error}; give another folder with --out") from error

    def close(self) -> None:
        """Close the file."""
        self._open.close()

    def done(self) -> dict[str, str]:
        """Signatures by tag."""
        return dict(self._open.execute("select tag, signature from loops"))

    def keep(self, rows: list[Row], signed: str) -> None:
        """Keep the rows of a task."""
        said = [(str(row["tag"]), signed, json.dumps(row, allow_nan=False)) for row in rows]
        with self._open:
            self._open.executemany("insert or replace into loops values (?, ?, ?)", said)

    def drop_others(self, tags: set[str]) -> None:
        """Forget loops that the plant's files no longer hold."""
        gone = [(tag,) for tag in self.done() if tag not in tags]
        with self._open:
            self._open.executemany("delete from loops where tag = ?", gone)

    def rows(self) -> Iterator[Row]:
        """All rows, one by one."""
        for (said,) in self._open.execute("select row from loops order by tag"):
            yield json.loads(said)


def rows_of(folder: Path) -> list[Row]:
    """The rows of an earlier audit, without their pictures; of an earlier program as well, whose rows hold less.

    Raises UserError: there is no audit in the folder, or one of a later program.
    """
    path = folder / NAME
    if not path.is_file():
        raise UserError(f"{folder}: no audit in it ({NAME}); give the folder of an earlier audit")
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as store:
            rows: list[Row] = [json.loads(said) for (said,) in store.execute("select row from loops order by tag")]
    except (sqlite3.Error, ValueError) as error:
        raise UserError(f"{path}: cannot be read: {error}") from error
    later = next((row for row in rows if row.get("schema") not in range(1, SCHEMA + 1)), None)
    if later is not None:
        said = f"of schema {later.get('schema')}, this program knows 1 to {SCHEMA}"
        raise UserError(f"{path}: {said}; take the program that made it, or a later one")
    return [{k: v for k, v in row.items() if k not in {"trend", "stretches"}} for row in rows]
