"""Whole files or none: what is written under a name is complete and on disk, whenever the power goes."""

import errno
import json
import os
import stat
from pathlib import Path


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file by way of a temporary one beside it: write, fsync, rename, fsync of the folder.

    Parameters
    ----------
    path : where; a symbolic link stays and its target is replaced, its permissions are kept. content : text is
        written as UTF-8.

    Raises
    ------
    OSError
        The system refused; the old file, if any, is as it was.
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
    finally:  # also when the user stops it; after the rename there is nothing left
        temporary.unlink(missing_ok=True)
    sync_folder(target.parent)


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
