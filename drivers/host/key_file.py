"""The file with the secret that commits are authenticated with: read once, and only if nobody else can read it."""

import os
import stat
from pathlib import Path

from retuner.drivers.device import DeviceError
from retuner.drivers.host.can_settings import KEY_BYTES_MIN

LARGEST = 4096  # bytes that a key file may have
OTHERS = stat.S_IRWXG | stat.S_IRWXO


class KeyFileError(DeviceError):
    """The key file cannot be used; the message never shows what is in it."""


def read_key(path: Path) -> bytes:
    """The key in a file of hexadecimal digits (spaces and line ends between them do not count).

    Raises KeyFileError: there is no such file, it is no plain file, it belongs to somebody else, others may read or
    write it, or it does not hold a whole number of bytes, at least 16, as hexadecimal digits.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
        with os.fdopen(handle, "rb") as file:  # what is checked is what is read: the open file itself
            about = os.fstat(handle)
            if not stat.S_ISREG(about.st_mode):
                raise KeyFileError(f"key file {path}: not a plain file")
            if os.name == "posix" and about.st_uid not in {os.getuid(), 0}:
                raise KeyFileError(f"key file {path}: belongs to user {about.st_uid}; it must be yours")
            if os.name == "posix" and about.st_mode & OTHERS:
                mode = f"{stat.S_IMODE(about.st_mode):o}"
                raise KeyFileError(f"key file {path}: others can read or write it (mode {mode}); chmod 600 {path}")
            if about.st_size > LARGEST:
                raise KeyFileError(f"key file {path}: {about.st_size} bytes; a key has at most {LARGEST}")
            text = file.read(LARGEST)
    except OSError as error:
        raise KeyFileError(f"key file {path}: {error.strerror or error}") from error
    try:
        key = bytes.fromhex(text.decode("ascii"))
    except ValueError:
        raise KeyFileError(
            f"key file {path}: not hexadecimal digits, two a byte; make one with: openssl rand -hex 32"
        ) from None
    if len(key) < KEY_BYTES_MIN:
        raise KeyFileError(f"key file {path}: {len(key)} bytes; give at least {KEY_BYTES_MIN} (32 digits)")
    return key
