"""Whole files or none: what is written under a name is complete and on disk, whenever the power goes."""

import errno
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file by way of a temporary one beside it: write, fsync, rename, fsync of the folder.

    path : where; a symbolic link stays and its target is replaced, its permissions are kept. content : text is
        written as UTF-8.

    Raises OSError: the system refused, with the path as its filename; the old file, if any, is as it was.
    """
    target = path.resolve()
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder; give the name of a file", str(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"the folder {path.parent} does not exist; make it first", str(path))
    old = target.exists()
    if old and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, "may not be written; give another file or allow it", str(path))
    raw = content.encode("utf-8") if isinstance(content, str) else content
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as stream:
            if old:
                temporary.chmod(stat.S_IMODE(target.stat().st_mode))
            stream.write(raw)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
    except OSError as error:  # a full disk names no file, and the temporary one means nothing to a person
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:  # also when the user stops it; after the rename there is nothing left
        temporary.unlink(missing_ok=True)
    sync_folder(target.parent)


class Unwritten:
    """Files that the system refused, when each of several is to be written whatever becomes of the others.

    lines : a line for each, in the order in which they were tried.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []

    @contextmanager
    def trying(self) -> Iterator[None]:
        """Write one of them here; what the system refuses is kept."""
        try:
            yield
        except OSError as error:
            self.lines.append(f"{error.filename}: {error.strerror or error}")

    def write(self, path: Path, content: str) -> None:
        """Write a file, see write_whole."""
        with self.trying():
            write_whole(path, content)


def write_json(path: Path, document: object) -> None:
    """A JSON document as a whole file, readable."""
    write_whole(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def sync_folder(folder: Path) -> None:
    """Put a folder's names on disk; where a folder cannot be opened for that (Windows) the system does it itself."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
