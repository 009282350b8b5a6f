"""How much a command tells beside its answer: -q (nothing), the default (progress and notes), -v (what it does, on the
error stream), -vv (everything, that of the libraries too). The options are the same in every command.

What a command answers stands on standard output whatever was chosen; errors are always told.
"""

import logging
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, TypeVar

import typer
from typer.main import get_command

FIRST_S = 2.0  # work that is done within this time shows no progress
EVERY_S = 0.5
LOGGER = logging.getLogger("retuner")
FORMAT = "%(relativeCreated)7.0f ms  %(name)s: %(message)s"
Command = TypeVar("Command")
_quiet = [False]


def quiet() -> bool:
    """Whether only the answer and errors are wanted."""
    return _quiet[0]


def be_normal() -> None:
    """Set what a command begins with: neither quiet nor verbose, no handler of an earlier command."""
    _quiet[0] = False
    for logger in (LOGGER, logging.getLogger()):
        for handler in [one for one in logger.handlers if isinstance(one, _ErrorStream)]:
            logger.removeHandler(handler)
    LOGGER.setLevel(logging.NOTSET)
    LOGGER.propagate = True


class _ErrorStream(logging.StreamHandler[Any]):
    """Ours, so that it can be told from an application's own handlers."""

    def __init__(self) -> None:
        super().__init__(sys.stderr)
        self.setFormatter(logging.Formatter(FORMAT))


def _hush(wanted: bool) -> None:
    _quiet[0] = _quiet[0] or wanted


def _tell_more(count: int) -> None:
    if count:
        (LOGGER if count == 1 else logging.getLogger()).addHandler(_ErrorStream())
        LOGGER.setLevel(logging.INFO if count == 1 else logging.DEBUG)
        LOGGER.propagate = count > 1


Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", callback=_hush, expose_value=False, help="Only the answer and errors.")
]
Verbose = Annotated[
    int,
    typer.Option(
        "--verbose",
        "-v",
        count=True,
        callback=_tell_more,
        expose_value=False,
        show_default=False,
        help="Show what is done; -vv: everything.",
    ),
]
_template = typer.Typer(add_completion=False)


@_template.command()
def _command(quiet: Quiet = False, verbose: Verbose = 0) -> None:
    """The two options that every command has."""


def with_verbosity(command: Command) -> Command:
    """The command, or every command of a group, with -q and -v; an option of its own by that name stays.

    Its help is plain text: what draws boxes round it takes as long to load as numpy.
    """
    vars(command)["rich_markup_mode"] = None
    for inner in getattr(command, "commands", {}).values():
        with_verbosity(inner)
    if not hasattr(command, "commands"):
        parameters: list[Any] = getattr(command, "params", [])
        taken = {name for parameter in parameters for name in parameter.opts}
        parameters.extend(one for one in get_command(_template).params if not taken & set(one.opts))
    return command


@contextmanager
def accounted(arguments: Sequence[str]) -> Iterator[None]:
    """A command as a whole: at its end -v tells what it was and what it took."""
    begun_s, cpu_s = time.monotonic(), time.process_time()
    try:
        yield
    finally:
        elapsed_s, used_s = time.monotonic() - begun_s, time.process_time() - cpu_s
        LOGGER.info("%s: took %.2f s, %.2f s of CPU", " ".join(arguments), elapsed_s, used_s)


@contextmanager
def busy(what: str) -> Iterator[None]:
    """While inside, a terminal shows after two seconds what is being done and for how long; gone at the end."""
    stream = sys.stderr
    if quiet() or not stream.isatty():
        yield
        return
    done = threading.Event()

    def tell_time() -> None:
        begun_s, shown, wait_s = time.monotonic(), 0, FIRST_S
        while not done.wait(wait_s):
            text = f"{what} ... {time.monotonic() - begun_s:.0f} s"
            stream.write("\r" + text.ljust(shown))
            stream.flush()
            shown, wait_s = len(text), EVERY_S
        if shown:
            stream.write("\r" + " " * shown + "\r")
            stream.flush()

    teller = threading.Thread(target=tell_time, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()
