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

from retuner.cli_experiment import app as experiment
from retuner.cli_records import diagnose, identify
from retuner.cli_session import approve, ledger, replay, report
from retuner.cli_tune import tune
from retuner.errors import UserError, one_line
from retuner.streams import open_streams

INTERRUPTED = 130  # 128 + SIGINT, as shells have it
INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h: a defect of ours, told apart from 1 and 2
WRONG_USE: type[Any] = typer.BadParameter.__mro__[1]  # UsageError; newer typers have a click of their own, so no import
ROOM_ERRORS = (("retuner.drivers.device", "DeviceError"), ("retuner.drivers.recorded.recording", "RecordingError"))
"""Errors of the rooms that a person can put right: module and name, looked up only if the module was ever imported."""

app = typer.Typer(
    name="retuner",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)

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


Interface = Annotated[
    str | None, typer.Option("--interface", "-i", help="python-can interface, as python-can spells it.")
]
Channel = Annotated[str | None, typer.Option("--channel", "-c", help="Channel of the interface.")]


@app.command(epilog="Example: retuner run examples/oven.toml --out runs/oven")
def run(
    config: ConfigFile,
    interface: Interface = None,
    channel: Channel = None,
    speed: Annotated[
        str, typer.Option(help="max: simulated time; a number: how much faster than real time the device runs.")
    ] = "max",
    mode: Annotated[str | None, typer.Option(help="off, advise, trial or auto; overrides the configuration.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for report, ledger, trend and bus log.")] = None,
    compare: Annotated[bool, typer.Option(help="Also run with fixed gains, where the plant is simulated.")] = True,
    pretune: Annotated[bool, typer.Option("--pretune", help="Begin with a step of co: first model and gains.")] = False,
    json: Json = False,
) -> int:
    """Watch a loop, retune it over CAN, and leave a report."""
    from retuner.commands.run import RunOptions
    from retuner.commands.run import run as work

    return work(config, RunOptions(interface, channel, speed, mode, out, compare, json, pretune))


@app.command(epilog="Example: retuner device examples/oven.toml -i udp_multicast -c 239.74.163.2 --speed 50")
def device(
    config: ConfigFile,
    interface: Interface = None,
    channel: Channel = None,
    speed: Annotated[float, typer.Option(help="How much faster than real time the simulated plant runs.")] = 1.0,
    duration: Annotated[float | None, typer.Option(help="Stop after so many simulated seconds.")] = None,
) -> int:
    """Be the controller: PID firmware with its simulated plant on a CAN bus, until stopped."""
    from retuner.commands.device import device as work

    return work(config, interface=interface, channel=channel, speed=speed, duration_s=duration)


app.command(epilog="Example: retuner replay runs/demo; retuner replay loop.csv --config loop.toml --columns pv=temp")(
    replay
)
app.command(epilog="Example: retuner report runs/demo; retuner report runs/demo --decision 7 --out page.html")(report)
app.command(epilog="Example: retuner approve runs/demo; retuner approve runs/demo 4bebeed6 --note 'as discussed'")(
    approve
)
app.command(epilog="Example: retuner tune --type fopdt --k 0.361 --tau1 138 --theta 14.2 --rule simc")(tune)


app.command(epilog="Example: retuner identify heater.csv --open-loop --columns pv=temperature,co=pwm")(identify)
app.command(epilog="Example: retuner diagnose loop.csv --kc 0.8 --tau-i 40 --co-min 0 --co-max 100 --plot loop.png")(
    diagnose
)


@app.command(epilog="Example: retuner reduce --num-t 15 --den-t 20,1,0.1,0.1 --k 2 --order 2")
def reduce(
    num_t: Annotated[
        list[str] | None, typer.Option("--num-t", help="Numerator time constants, s; negative: inverse response.")
    ] = None,
    den_t: Annotated[list[str] | None, typer.Option("--den-t", help="Lags, s, separated by commas.")] = None,
    integrators: Annotated[int, typer.Option(help="Pure integrators.")] = 0,
    delay: Annotated[float, typer.Option(help="Dead time, s.")] = 0.0,
    order: Annotated[int, typer.Option(help="Order of the model: 1 for PI, 2 for PID.")] = 1,
    k: Annotated[float, typer.Option(help="Steady-state gain; slope gain per second with an integrator.")] = 1.0,
    leads: Annotated[
        str, typer.Option(help="auto; rules: T1 to T3 for all positive numerator time constants; subtract: none.")
    ] = "auto",
    json: Json = False,
) -> int:
    """A first- or second-order model of a process of any order, by the half rule."""
    from retuner.commands.reduce import ReduceOptions
    from retuner.commands.reduce import reduce as work

    return work(ReduceOptions(k, num_t or [], den_t or [], integrators, delay, order, leads), as_json=json)


app.add_typer(ledger, name="ledger")
app.add_typer(experiment, name="experiment")


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit status. Arguments are those of the process unless given."""
    for library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(library, "1")  # fits are thousands of small matrices, which threads only slow down
    open_streams()
    if not os.environ.get("RETUNER_TRACEBACK"):
        sys.excepthook = _tell_internal_error
    try:
        status = get_command(app).main(arguments, prog_name="retuner", standalone_mode=False)
    except UserError as error:
        return _tell(error.exit_status, *error.lines)
    except WRONG_USE as error:
        path = error.ctx.command_path if error.ctx else "retuner"
        wrong = error.format_message()  # empty without arguments: the help was shown instead
        return _tell(2, *([f"{path}: {wrong} `{path} --help` shows how it is used."] if wrong else []))
    except (KeyboardInterrupt, typer.Abort):
        return _tell(INTERRUPTED, "retuner: interrupted")
    except _room_errors() as error:
        return _tell(2, str(error))
    except OSError as error:
        return _tell(2, f"{error.filename or 'retuner'}: {error.strerror or error}")
    if status == INTERRUPTED:  # newer typer turns Ctrl-C into a status, older ones into Abort
        return _tell(INTERRUPTED, "retuner: interrupted")
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
