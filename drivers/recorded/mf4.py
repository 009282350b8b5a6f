"""MF4: the one format of bus traffic whose library takes longer to load than all the rest of python-can together.

python-can loads asammdf, and pandas with it, wherever it is installed, also where no MF4 is ever read: up to a second
of each command. So the command line hides it until an MF4 is opened. In other people's programs nothing is hidden.
"""

import contextlib
import importlib
import logging
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    import can

LIBRARY = "asammdf"
_loaded: dict[str, Any] = sys.modules


def hide_library() -> None:
    """Let python-can load without it, where neither of the two is loaded yet; for a process of our own only."""
    _loaded.setdefault(LIBRARY, None)  # what Python takes for a module that is not there


def _show_library() -> None:
    """Load it into python-can, where it was hidden."""
    if LIBRARY in _loaded and _loaded[LIBRARY] is None:
        del _loaded[LIBRARY]
        importlib.reload(importlib.import_module("can.io.mf4"))


def mf4_reader(stream: BinaryIO) -> "Iterable[can.Message]":
    """python-can's reader of MF4. Raises NotImplementedError: asammdf is not installed."""
    _show_library()
    reader: Iterable[can.Message] = importlib.import_module("can.io.mf4").MF4Reader(stream)
    return reader


def mf4_errors() -> tuple[type[Exception], ...]:
    """What asammdf and its decompressor raise of their own; their own words about it stay away from the screen."""
    _show_library()
    logging.getLogger(LIBRARY).setLevel(logging.CRITICAL + 1)
    found: list[type[Exception]] = []
    for module, name in ((f"{LIBRARY}.blocks.utils", "MdfException"), ("isal.isal_zlib", "IsalError")):
        with contextlib.suppress(ImportError, AttributeError):
            found.append(getattr(importlib.import_module(module), name))
    return tuple(found)
