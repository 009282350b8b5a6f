"""The options of `retuner experiment`, of each test."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import Channel, FormOptions, Interface, Json, Loop, Plot, argument, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="Make a step, setpoint or relay test, or evaluate a recorded one.",
    epilog="Example: retuner experiment relay examples/oven.toml --amplitude 5",
)

Rule = Annotated[str, typer.Option(help="Tuning rule.")]
ControllerKind = Annotated[str | None, typer.Option("--kind", help="p, pi or pid, as the rule has it.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedOptions(FormOptions):
    """A recorded experiment and how to show it."""

    file: Path | None = option(None, "Evaluate this recording instead.", "--from", metavar="FILE")
    plot: Plot = None
    method: str = option("fit", "Whose model is tuned for; fit, or a named method of this test.")
    rule: Rule = "simc"
    kind: ControllerKind = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class ControllerOptions:
    """A test on a controller."""

    config: Path | None = argument(None, "Configuration (TOML): run the test on its controller.", metavar="[CONFIG]")
    interface: Interface = None
    channel: Channel = None
    speed: str = option("max", "max: simulated time; a number: how fast the far side's time runs.")
    pv_low: float | None = option(None, "Abort below this pv; default the loop's range.")
    pv_high: float | None = option(None, "Abort above this pv; default the loop's range.")
    deviation: float | None = option(None, "Abort so far from rest, pv units; default 20 % of the range.")
    time: float | None = option(None, "Longest excitation, s; default 2000 samples.", "--time")
    rest: float | None = option(None, "Longest wait for rest, s; default 300 samples.", "--rest")
    out: Path | None = option(None, "Folder for record, picture, ledger and bus log.")
    loop: Loop = None
    as_json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class OnDemandOptions(RecordedOptions, ControllerOptions):
    """A test on a controller, or a recorded one."""

    yes: bool = option(False, "The settings are confirmed: write them.", "--yes")


@dataclass(frozen=True, slots=True, kw_only=True)
class StepOptions(OnDemandOptions):
    """Open-loop step of the output. Methods: fit, two-point, tangent, reaction-curve, 63-percent, slope."""

    amplitude: float | None = option(None, "Step of co, percent; default 5 % of its range.")


@dataclass(frozen=True, slots=True, kw_only=True)
class SetpointOptions(OnDemandOptions):
    """Setpoint step under proportional control, or with --hold out and back under the active gains, for `diagnose`.

    Methods: fit, two-step; --rule setpoint-overshoot needs no model.
    """

    amplitude: float | None = option(None, "Step of sp, pv units; default 5 % of the range.")
    kc0: float | None = option(None, "Proportional gain of the test; default the active one.")
    hold: float = option(0.0, "Out for so long and back, s, under the active gains.")
    from_diagnosis: Path | None = option(None, "The test that `retuner diagnose --json` proposed.", metavar="FILE")


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayOptions(OnDemandOptions):
    """Relay feedback: Ku and Pu, and a model. Methods: fit, asymmetric; rules zn-ultimate ... take Ku and Pu."""

    amplitude: float | None = option(None, "Of the relay, percent of co; default 5 % of range.")
    bias: float = option(0.3, "Asymmetry, 0 to 0.8; some lets the process gain show.")
    hysteresis: float | None = option(None, "Pv units; default 3 x the noise seen at rest.")
    cycles: int = option(4, "Full waves that count, 2 to 50.")


@dataclass(frozen=True, slots=True, kw_only=True)
class UltimateOptions(RecordedOptions):
    """A swing under proportional control: its period, and whether the gain was the ultimate one."""

    file: Annotated[Path, typer.Option("--from", metavar="FILE", help="Recording of the swing.")]
    kc: float | None = option(None, "Proportional gain under which it swung.")
    rule: Rule = "zn-ultimate"


@dataclass(frozen=True, slots=True, kw_only=True)
class ValveOptions(FormOptions, ControllerOptions):
    """Small steps of co up and down in manual: resolution, dead band and stroke of the valve, with their odds."""

    file: Path | None = option(None, "Evaluate this record; alone: show the moves.", "--from", metavar="FILE")
    step: float = option(0.5, "Small step, percent of co.")
    hold: float | None = option(None, "Hold each for so long, s: four times the time to half of pv's change.")
    short: bool = option(False, "Up, up, down, down only: for `diagnose`.", "--short")


command(
    app,
    StepOptions,
    "experiment.step",
    "Examples: retuner experiment step examples/oven.toml --amplitude 5; "
    "retuner experiment step --from heater.csv --columns pv=temperature",
)
command(
    app,
    SetpointOptions,
    "experiment.setpoint",
    "Examples: retuner experiment setpoint examples/oven.toml --amplitude 5 --kc0 1.5; "
    "retuner experiment setpoint --from loop.csv --kc0 1.5 --rule setpoint-overshoot",
)
command(
    app,
    RelayOptions,
    "experiment.relay",
    "Examples: retuner experiment relay examples/oven.toml --amplitude 10 --bias 0.3; "
    "retuner experiment relay --from relay.csv --rule zn-ultimate --kind pid",
)
command(app, UltimateOptions, "experiment.ultimate", "Example: retuner experiment ultimate --from swing.csv --kc 3.2")
command(
    app,
    ValveOptions,
    "experiment.valve",
    "Examples: retuner experiment valve examples/oven.toml --step 0.5 --hold 120; "
    "retuner experiment valve --from valve.csv",
)
