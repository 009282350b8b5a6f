"""Standard streams as they may be met: closed, in a narrow encoding, or going away while a controller is being watched.

What is shown is never worth more than what it tells of: a screen that fails is given up, and the run goes on.
"""

import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TextIO


def open_streams() -> None:
    """Let stdout and stderr take whatever is written: characters that the encoding lacks become escapes. A stream
    that was closed before the start leads nowhere.
    """
    for name, way in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open(way, encoding="utf-8"))  # noqa: SIM115  for good
        elif way == "w" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class LastingStream:
    """A text stream that never raises OSError: the first one is told on stderr, and nothing is written after it.

    stream : what is written to.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lost = False

    def __getattr__(self, name: str) -> object:
        """Whatever else a stream can do (encoding, isatty, fileno)."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, or not; the number of characters as if it had been."""
        self._unless_lost(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush, or not."""
        self._unless_lost(self._stream.flush)

    def _unless_lost(self, do: Callable[[], object]) -> None:
        if self._lost:
            return
        try:
            do()
        except OSError as error:
            self._lost = True
            with suppress(OSError):  # what is buffered must not fail again when the process ends
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())
                os.close(nowhere)
            with suppress(OSError):
                told = error.strerror or error
                sys.stderr.write(f"retuner: nothing more can be shown: {told}; the work goes on\n")
