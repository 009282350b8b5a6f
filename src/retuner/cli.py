"""The command line: which commands there are. Each one stands in commands/ and is imported
when it is called, so that `retuner --help` does not wait for numpy, scipy or python-can.

A command returns its exit status: 0 ok, 1 the question's answer is no; main() adds 2 for wrong use or bad input, each
problem one line on stderr, and 130 for Ctrl-C. Nobody sees a traceback unless RETUNER_TRACEBACK is set.
"""

import os
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperArgument, TyperGroup, TyperOption
from typer.main import get_command

from retuner.drivers.recorded.mf4 import hide_library
from retuner.errors import UserError, one_line
from retuner.streams import open_streams
from retuner.verbosity import Quiet, Verbose, accounted, be_normal, with_verbosity

INTERRUPTED = 130  # 128 + SIGINT, as shells have it
INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h: a defect of ours, told apart from 1 and 2
WRONG_USE: type[Any] = typer.BadParameter.__mro__[1]  # UsageError; newer typers have a click of their own, so no import
DRIVER_ERRORS = (("retuner.drivers.device", "DeviceError"), ("retuner.drivers.recorded.recording", "RecordingError"))
"""Errors of drivers that a person can put right: module and name, looked up only if the module was ever imported."""
COMMANDS = {
    "init": "Write a commented starter configuration.",
    "check": "Check a configuration: each error with file, line, key and limit.",
    "run": "Watch a loop, retune it over CAN, and leave a report.",
    "device": "Run a virtual controller with a simulated plant on a CAN bus, until stopped.",
    "conformance": "Test a device on a bus against the protocol and report every deviation.",
    "replay": "Repeat the decisions of a session byte for byte, or apply retuner to a recorded log.",
    "serve": "Show sessions in a browser, live and afterwards, with operator approval.",
    "report": "Write the report of a recorded session again, or the page of one decision.",
    "approve": "Approve a proposal, named by its hash, or list the open ones.",
    "export": "Write a gain table for firmware, a PLC or a CAN tool, or back into its configuration.",
    "tune": "Compute settings for a known process by a tuning rule, with margins.",
    "identify": "Identify the process from a record: model, standard deviations and settings.",
    "diagnose": "Find the cause of a loop's behaviour, with evidence and recommended settings.",
    "schedule": "Design a gain schedule from records: curves over a variable, and the fewest regions that serve it.",
    "audit": "Rank the loops of a plant by need for attention, from a folder of trends.",
    "reduce": "Reduce a process model to first or second order by the half rule.",
    "ledger": "Read, verify, export or revert what was seen, decided and written.",
    "experiment": "Make a step, setpoint or relay test, or evaluate a recorded one.",
    "doctor": "Check what works on this machine, and what to do about the rest.",
}
"""Every command and what `retuner --help` says of it."""
WHOLE = frozenset({"check", "conformance", "device", "doctor", "export", "serve"})
"""Commands in one file; what can be typed of the others stands in commands/signatures.py, apart from what they load."""


def app_of(command: str, within: str = "") -> typer.Typer:
    """A command as typer has it, with its options. within : the one of a group that is called, where that is known."""
    if command in WHOLE:
        found: typer.Typer = import_module(f"retuner.commands.{command}").app
        return found
    from retuner.commands.signatures import app_of as typed  # noqa: PLC0415  not for the list of commands

    return typed(command, within)


def _readable(text: str) -> Path:
    """Raises ValueError: the file may not be read."""
    path = Path(text)
    if path.exists() and not os.access(path, os.R_OK):
        raise ValueError(text)
    return path


READERS: dict[object, Callable[[Any], object]] = {str: str, int: int, float: float, Path: _readable}
NUMBERS: dict[object, str] = {int: "give a whole number", float: "give a number"}
"""What to do about a value that is none."""


class _Plain:
    """How a value of an option or argument is read: text, numbers and paths by themselves, the rest by typer.

    typer has pydantic read every value, which takes as long to load as numpy.
    """

    def __init__(self, parameter: Any) -> None:  # noqa: ANN401  typer's, which no public type names
        kind, info = parameter.type_descriptor.annotation, parameter.type_descriptor.parameter_info
        free = info.min is None and info.max is None
        one = get_args(kind)[0] if get_origin(kind) is list else kind
        self._read = READERS.get(one) if free else None
        self._wanted = NUMBERS.get(one) if free else None

    def coerce(self, value: Any, param: Any, ctx: object) -> object:  # noqa: ANN401
        """The value; for what is not a plain one, typer's or its error."""
        several = param.multiple or param.nargs == -1
        if value is None:
            return () if several else None
        try:
            if self._read is not None:
                return [self._read(one) for one in value] if several else self._read(value)
        except ValueError:
            if self._wanted is not None:
                raise typer.BadParameter(f"{value!r}; {self._wanted}", param=param) from None
        return BY_TYPER(param).coerce(value, param=param, ctx=ctx)


def _plain(parameter: Any) -> _Plain:  # noqa: ANN401
    return _Plain(parameter)


BY_TYPER: Any = getattr(TyperOption, "get_runtime_param", None)
if BY_TYPER is not None:  # a typer with pydantic; on its classes, for it makes the option --help itself and late
    TyperOption.get_runtime_param = TyperArgument.get_runtime_param = _plain  # type: ignore[assignment,method-assign]


class Commands(TyperGroup):
    """Lists commands by their help alone and imports the one that is called."""

    def resolve_command(self, *given: Any, **named: Any) -> tuple[str | None, Any, list[str]]:
        """The command's own module in place of its entry in the list."""
        name, _, rest = super().resolve_command(*given, **named)
        return name, with_verbosity(get_command(app_of(name or "", *rest[:1]))), rest


app = typer.Typer(
    name="retuner",
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version as installed_version  # noqa: PLC0415  slow to load

        sys.stdout.write(f"retuner {installed_version('retuner')}\n")
        raise typer.Exit


@app.callback()
def retuner(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Gain scheduling and on-line adaptive PID: finds causes, proves changes, writes gains over CAN."""


def listed() -> None:
    """Stands for a command in the list."""


for _name, _help in COMMANDS.items():
    app.command(_name, short_help=_help)(listed)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit status. Arguments are those of the process unless given."""
    for library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(library, "1")  # fits are thousands of small matrices, which threads only slow down
    hide_library()
    open_streams()
    be_normal()
    if not os.environ.get("RETUNER_TRACEBACK"):
        sys.excepthook = _tell_internal_error
    try:
        with accounted(sys.argv[1:] if arguments is None else arguments):
            status = get_command(app).main(arguments, prog_name="retuner", standalone_mode=False)
    except UserError as error:
        return _tell(error.exit_status, *error.lines)
    except WRONG_USE as error:
        path, wrong = error.ctx.command_path if error.ctx else "retuner", error.format_message()
        if error.ctx and wrong == error.ctx.get_help():  # without arguments
            sys.stdout.write(f"{wrong}\n")
            return 2
        return _tell(2, f"{path}: {wrong.rstrip('.')}. `{path} --help` shows how it is used.")
    except (KeyboardInterrupt, typer.Abort):
        return _tell(INTERRUPTED, "retuner: interrupted")
    except tuple(getattr(sys.modules[home], name) for home, name in DRIVER_ERRORS if home in sys.modules) as error:
        return _tell(2, str(error))
    except OSError as error:
        return _tell(2, f"{error.filename or 'retuner'}: {error.strerror or error}")
    if status == INTERRUPTED:  # newer typer turns Ctrl-C into a status, older ones into Abort
        return _tell(INTERRUPTED, "retuner: interrupted")
    return status if isinstance(status, int) else 0


def _tell(status: int, *lines: str) -> int:
    for line in lines:
        sys.stderr.write(one_line(line) + "\n")
    return status


def _tell_internal_error(kind: type[BaseException], error: BaseException, at: TracebackType | None) -> None:
    """A defect of ours, in one line with its place; the status is not one that means an answer."""
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    place = f"{Path(at.tb_frame.f_code.co_filename).name}:{at.tb_lineno}" if at is not None else "?"
    what = f"retuner: internal error in {place}: {kind.__name__}: {error}"
    raise SystemExit(_tell(INTERNAL_ERROR, f"{what}; please report it with the output under RETUNER_TRACEBACK=1"))
