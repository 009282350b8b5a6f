"""The command line: signatures and help only. Each command's work stands in commands/<name>.py, imported when called,
so that `retuner --help` does not wait for numpy, scipy or python-can.

A command returns its exit status: 0 ok, 1 the question's answer is no; main() adds 2 for wrong use or bad input, each
problem one line on stderr, and 130 for Ctrl-C. Nobody sees a traceback unless RETUNER_TRACEBACK is set.
"""

import os
import sys
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any

import typer
from typer.main import get_command

from retuner.errors import UserError, one_line

INTERRUPTED = 130  # 128 + SIGINT, as shells have it
INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h: a defect of ours, told apart from 1 and 2
WRONG_USE: type[Any] = typer.BadParameter.__mro__[1]  # UsageError; typer has its own click from 0.20 on, so no import
ROOM_ERRORS = (("retuner.drivers.device", "DeviceError"), ("retuner.drivers.recording", "RecordingError"))
"""Errors of the rooms that a person can put right: module and name, looked up only if the module was ever imported."""

app = typer.Typer(
    name="retuner", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)  # fmt: skip

ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version as installed_version

        sys.stdout.write(f"retuner {installed_version('retuner')}\n")
        raise typer.Exit


@app.callback()
def retuner(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show it.")] = False,
) -> None:
    """Gain scheduling and on-line adaptive PID: finds the cause, proves the cure, changes gains over CAN."""


@app.command(epilog="Example: retuner init oven.toml")
def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = Path("retuner.toml"),
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
) -> int:
    """Write a commented starter configuration."""
    from retuner.commands.init import init as work

    return work(file, force=force)


@app.command(epilog="Example: retuner check oven.toml")
def check(file: ConfigFile, json: Json = False) -> int:
    """Say what is wrong with a configuration: file, line, key, limit; or show it when all is well."""
    from retuner.commands.check import check as work

    return work(file, as_json=json)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit status. Arguments are those of the process unless given."""
    if not os.environ.get("RETUNER_TRACEBACK"):
        sys.excepthook = _tell_internal_error
    try:
        status = get_command(app).main(arguments, prog_name="retuner", standalone_mode=False)
    except UserError as error:
        return _tell(error.exit_status, *error.lines)
    except WRONG_USE as error:
        path = error.ctx.command_path if error.ctx else "retuner"
        return _tell(2, f"{path}: {error.format_message()} `{path} --help` shows how it is used.")
    except (KeyboardInterrupt, typer.Abort):
        return _tell(INTERRUPTED, "retuner: interrupted")
    except _room_errors() as error:
        return _tell(2, str(error))
    except OSError as error:
        return _tell(2, f"{error.filename or 'retuner'}: {error.strerror or error}")
    return status if isinstance(status, int) else 0


def _room_errors() -> tuple[type[Exception], ...]:
    """The rooms' error types of the modules that are in use; asked only when an error passes by."""
    return tuple(getattr(sys.modules[module], name) for module, name in ROOM_ERRORS if module in sys.modules)


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
