"""Which engine computes the fits: the compiled one where it was built, else numpy. Chosen here and nowhere else.

`prefer` says which: auto (the default), c, or numpy; when the package is imported it hands RETUNER_ENGINE over. Both do
the same mathematics, equal to rounding; numpy is the reference, and all that a machine without a compiler needs. An
engine that was built for another version of this package is not used.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib import import_module
from types import ModuleType

VARIABLE = "RETUNER_ENGINE"
CHOICES = ("auto", "c", "numpy")
COMPILED_VERSION = "16"  # Version of the compiled engine that belongs to this package

_preferred = ["auto"]
_within: ContextVar[str | None] = ContextVar("engine", default=None)


def compiled() -> ModuleType | None:
    """The compiled engine (compiled.py), or None where numpy is to compute.

    Raises ValueError: RETUNER_ENGINE names no engine, or asks for the compiled one where there is none.
    """
    return _chosen(_within.get() or _preferred[0])


def prefer(name: str) -> None:
    """Let fits be computed by the engine of this name from now on; the first fit refuses a wrong name."""
    _preferred[0] = name


@contextmanager
def using(name: str) -> Iterator[None]:
    """Within the block, in this thread or task, fits are computed by the engine of this name."""
    token = _within.set(name)
    try:
        yield
    finally:
        _within.reset(token)


def engine_name() -> str:
    """Name and version for the ledger: "c 5", or "numpy" with its version."""
    return f"numpy {import_module('numpy').__version__}" if compiled() is None else f"c {COMPILED_VERSION}"


@cache
def _chosen(name: str) -> ModuleType | None:
    if name not in CHOICES:
        raise ValueError(f"{VARIABLE} = {name!r}: give one of {', '.join(CHOICES)}")
    if name == "numpy":
        return None
    try:
        version = import_module("retuner.adaptive.fit._engine").version
        reason = f"has version {version}; version {COMPILED_VERSION} is needed" if version != COMPILED_VERSION else ""
    except ImportError as error:
        reason = f"cannot be loaded ({error})"
    if reason and name == "c":
        raise ValueError(f"{VARIABLE} = c: the compiled engine {reason}")
    return None if reason else import_module("retuner.adaptive.fit.compiled")
