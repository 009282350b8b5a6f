"""Options that several commands share, and how a dataclass of options becomes a command's signature."""

import json
import sys
from collections.abc import Iterable, Mapping
from functools import partial, wraps
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from retuner.errors import UserError, user_input
from retuner.files import write_whole
from retuner.schedule.late_dataclass import dataclass, field, fields, replace

if TYPE_CHECKING:  # slow to load, and most commands have no configuration
    from retuner.config.model import Config
    from retuner.config.session_config import SessionConfig
    from retuner.schedule.controller_units import ControllerUnits

ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).")]
Session = Annotated[Path, typer.Argument(metavar="SESSION", help="Folder of a session, finished or running.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Interface = Annotated[str | None, typer.Option("--interface", "-i", help="python-can interface.")]
Channel = Annotated[str | None, typer.Option("--channel", "-c", help="Channel of the interface.")]
Loop = Annotated[str | None, typer.Option("--loop", metavar="NAME", help="Which loop, where there are several.")]
By = Annotated[str | None, typer.Option(help="Who requests it; default: the user of this process.")]
Note = Annotated[str, typer.Option(help="Why, for the ledger.")]

Controller = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Whose gains are given and shown: deltav-standard, yokogawa, px4 ... (a wrong name shows the list), or "
        "units: kc-s, gain-min, pb-rpm.",
    ),
]
ActionOption = Annotated[
    str | None,
    typer.Option("--action", help="With --controller: reverse or direct acting; else the sign of the gain says it."),
]
PvSpan = Annotated[float | None, typer.Option(help="Span of pv, in its own unit; gain and pb refer to it.")]
Plot = Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the record with the result: .png or .svg.")]
CONTROLLER = "--controller, --action, --pv-span"

T = TypeVar("T")


def option(default: T, text: str, *names: str, metavar: str | None = None, panel: str | None = None) -> T:
    """A field of a dataclass of options. text : its help. names : where they are not the field's own."""
    shown = partial(typer.Option, *names, help=text, metavar=metavar, rich_help_panel=panel)
    return field(default=default, metadata={"shown": shown})


def argument(default: T, text: str, *, metavar: str | None = None) -> T:
    """An option that is given by its place."""
    return field(default=default, metadata={"shown": partial(typer.Argument, help=text, metavar=metavar)})


PANEL = "The form of the record (else detected, and reported)"


@dataclass(frozen=True, slots=True, kw_only=True)
class FormOptions:
    """How a record is written; what is left open is found in it."""

    columns: str = option("", "Names of columns: t=time,pv=temp,co=out,sp=target.", panel=PANEL)
    tag: str = option("", "Which loop of many: FIC101 of FIC101.PV.", panel=PANEL)
    sp: float | None = option(None, "The setpoint where no column has it.", panel=PANEL)
    dt: float | None = option(None, "Seconds between rows where no column has the time.", panel=PANEL)
    time_format: str = option("", "Format of time stamps: %d.%m.%Y %H:%M:%S.", panel=PANEL)
    time_unit: str = option("", "Time as a number: s, ms, min, h, d.", panel=PANEL)
    zone: str = option("", "Time zone of stamps without one: Europe/Berlin.", panel=PANEL)
    decimal: str = option("", "Decimal mark: . or ,", panel=PANEL)
    good: str = option("", "Quality code of a good value.", panel=PANEL)
    bad: str = option("", "Another code for a missing value.", panel=PANEL)
    scale: str = option("", "Raw signals: pv=4..20:0..200,co=mA:0..100 or counts.", panel=PANEL)
    dbc: list[Path] | None = option(
        None, "What the frames of bus traffic mean; may be repeated.", metavar="FILE", panel=PANEL
    )
    record: Path | None = option(None, "A file with all of this in its section record.", metavar="TOML", panel=PANEL)
    assume: bool = option(False, "Print what was assumed as a section record.", "--assume", panel=PANEL)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOptions(FormOptions):
    """A recorded loop and the controller that was in force; times in seconds, limits in units of co."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="A record as exported: text or Parquet, or a file for each signal."),
    ]
    open_loop: bool = option(False, "The loop was in manual.", "--open-loop")
    kc: float | None = option(None, "Active controller gain.")
    tau_i: float | None = option(None, "Its integral time, s.")
    tau_d: float = option(0.0, "Its derivative time, s.")
    form: str = option("series", "Form of these: series, ideal or parallel.")
    controller: Controller = None
    action: ActionOption = None
    pv_span: PvSpan = None
    co_min: float | None = option(None, "Lower limit of co, in its own unit.")
    co_max: float | None = option(None, "Upper limit of co.")
    begin: str = option("", "Begin here: seconds of the record, or 2026-05-04T08:30.", "--from", metavar="WHEN")
    end: str = option("", "End here, likewise.", "--to", metavar="WHEN")
    plot: Plot = None
    as_json: Json = False


def command(app: typer.Typer, options: type[Any], work: str, epilog: str) -> None:
    """Give an app a command with an option for each field of a dataclass, whose docstring is its help; its work is
    loaded when it is called. work : module in commands/, and its function, of the options.
    """
    module, _, name = work.rpartition(".")

    @wraps(options, updated=())
    def called(**given: Any) -> int:
        return int(getattr(import_module(f"retuner.commands.{module}"), name)(options(**given)))

    plain = signature(options, eval_str=True)
    shown = {one.name: one.metadata.get("shown") for one in fields(options)}
    told = [
        one if (how := shown[key]) is None else one.replace(annotation=Annotated[one.annotation, how()])
        for key, one in plain.parameters.items()
    ]
    called.__signature__ = plain.replace(parameters=told)  # type: ignore[attr-defined]
    app.command(name, short_help=" ".join(str(options.__doc__).partition("\n\n")[0].split()), epilog=epilog)(called)


def check_plot(path: Path | None) -> None:
    """Refuse a picture of another kind. Raises UserError: the name ends neither in .png nor in .svg."""
    if path is not None and path.suffix.lower() not in {".png", ".svg"}:
        raise UserError(f"--plot {path}: give a name that ends in .png or .svg")


def put_file(path: Path, text: str) -> None:
    """Write a file that a person has named. Raises UserError: the system refuses."""
    try:
        write_whole(path, text)
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror}") from None


def tell(document: Mapping[str, object], lines: Iterable[str], *, as_json: bool) -> None:
    """The answer of a command: one JSON document, or lines."""
    sys.stdout.write((json.dumps(document, indent=2, allow_nan=False) if as_json else "\n".join(lines)) + "\n")


def on_bus(config: "Config", interface: str | None, channel: str | None) -> "Config":
    """The configuration with the bus that the command line names."""
    changes = {name: value for name, value in {"interface": interface, "channel": channel}.items() if value is not None}
    return config.model_copy(update={"bus": config.bus.model_copy(update=changes)}) if changes else config


def all_on_bus(session: "SessionConfig", interface: str | None, channel: str | None) -> "SessionConfig":
    """The configuration with the bus options, for all loops of a session.

    Raises UserError: they hang on several buses: which one is meant?
    """
    if (interface or channel) is not None and len(session.buses) > 1:
        raise UserError(
            f"--interface, --channel: name one bus, and the loops depend on {len(session.buses)}; name them in the file"
        )
    return replace(session, loops=tuple(on_bus(config, interface, channel) for config in session.loops))


NOT_PERCENT = {(0.0, 1.0): "0..1", (4.0, 20.0): "mA"}  # limits of co that are another unit's, and how --scale calls it


def controller_units(
    name: str | None,
    pv_span: float | None,
    action: str | None,
    co_limits: tuple[float | None, float | None] = (None, None),
) -> "ControllerUnits | None":
    """The units that the options name, None without a name. co_limits : those of co that the options give.

    Raises UserError: there are no such units, they need a span that is not given, or co is not in percent of its own.
    """
    from retuner.schedule.controller_units import ControllerUnits
    from retuner.schedule.dials import told_of_spans

    if name is not None and pv_span is None and told_of_spans(name):
        raise UserError(f"--controller {name} needs the span of pv: give --pv-span")
    recorded = next((told for limits, told in NOT_PERCENT.items() if limits == co_limits), None)
    if name is not None and recorded and told_of_spans(name):
        raise UserError(f"--controller {name} counts co in percent: give --scale co={recorded}:0..100, and limits so")
    if name is None:
        if action is not None:
            raise UserError("--action needs --controller: say whose gains are given, as in --controller pb-rpm")
        return None
    with user_input(CONTROLLER):
        return ControllerUnits.named(name, pv_span, action=action)
