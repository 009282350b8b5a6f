"""The options of `retuner experiment`, of each test."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import Channel, FormOptions, Interface, Json, Loop, Plot, command

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

    file: Annotated[Path | None, typer.Option("--from", metavar="FILE", help="Evaluate this recording instead.")] = None
    plot: Plot = None
    method: Annotated[str, typer.Option(help="Whose model is tuned for; fit, or a named method of this test.")] = "fit"
    rule: Rule = "simc"
    kind: ControllerKind = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class ControllerOptions:
    """A test on a controller."""

    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="Configuration (TOML): run the test on its controller.")
    ] = None
    interface: Interface = None
    channel: Channel = None
    speed: Annotated[str, typer.Option(help="max: simulated time; a number: how fast the far side's time runs.")] = (
        "max"
    )
    pv_low: Annotated[float | None, typer.Option(help="Abort below this pv; default the loop's range.")] = None
    pv_high: Annotated[float | None, typer.Option(help="Abort above this pv; default the loop's range.")] = None
    deviation: Annotated[
        float | None, typer.Option(help="Abort so far from rest, pv units; default 20 % of the range.")
    ] = None
    time: Annotated[float | None, typer.Option("--time", help="Longest excitation, s; default 2000 samples.")] = None
    rest: Annotated[float | None, typer.Option("--rest", help="Longest wait for rest, s; default 300 samples.")] = None
    out: Annotated[Path | None, typer.Option(help="Folder for record, picture, ledger and bus log.")] = None
    loop: Loop = None
    as_json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class OnDemandOptions(RecordedOptions, ControllerOptions):
    """A test on a controller, or a recorded one."""

    yes: Annotated[bool, typer.Option("--yes", help="The settings are confirmed: write them.")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StepOptions(OnDemandOptions):
    """Open-loop step of the output. Methods: fit, two-point, tangent, reaction-curve, 63-percent, slope."""

    amplitude: Annotated[float | None, typer.Option(help="Step of co, percent; default 5 % of its range.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SetpointOptions(OnDemandOptions):
    """Setpoint step under proportional control, or with --hold out and back under the active gains, for `diagnose`.

    Methods: fit, two-step; --rule setpoint-overshoot needs no model.
    """

    amplitude: Annotated[float | None, typer.Option(help="Step of sp, pv units; default 5 % of the range.")] = None
    kc0: Annotated[float | None, typer.Option(help="Proportional gain of the test; default the active one.")] = None
    hold: Annotated[float, typer.Option(help="Out for so long and back, s, under the active gains.")] = 0.0
    from_diagnosis: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The test that `retuner diagnose --json` proposed.")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayOptions(OnDemandOptions):
    """Relay feedback: Ku and Pu, and a model. Methods: fit, asymmetric; rules zn-ultimate ... take Ku and Pu."""

    amplitude: Annotated[float | None, typer.Option(help="Of the relay, percent of co; default 5 % of range.")] = None
    bias: Annotated[float, typer.Option(help="Asymmetry, 0 to 0.8; some lets the process gain show.")] = 0.3
    hysteresis: Annotated[float | None, typer.Option(help="Pv units; default 3 x the noise seen at rest.")] = None
    cycles: Annotated[int, typer.Option(help="Full waves that count, 2 to 50.")] = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class UltimateOptions(RecordedOptions):
    """A swing under proportional control: its period, and whether the gain was the ultimate one."""

    file: Annotated[Path, typer.Option("--from", metavar="FILE", help="Recording of the swing.")]
    kc: Annotated[float | None, typer.Option(help="Proportional gain under which it swung.")] = None
    rule: Rule = "zn-ultimate"


@dataclass(frozen=True, slots=True, kw_only=True)
class ValveOptions(FormOptions, ControllerOptions):
    """Small steps of co up and down in manual: resolution, dead band and stroke of the valve, with their odds."""

    file: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="Evaluate this record; alone: show the moves.")
    ] = None
    step: Annotated[float, typer.Option(help="Small step, percent of co.")] = 0.5
    hold: Annotated[
        float | None, typer.Option(help="Hold each for so long, s: four times the time to half of pv's change.")
    ] = None
    short: Annotated[bool, typer.Option("--short", help="Up, up, down, down only: for `diagnose`.")] = False


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
command(
    app,
    UltimateOptions,
    "experiment.ultimate",
    "Example: retuner experiment ultimate --from swing.csv --kc 3.2",
)
command(
    app,
    ValveOptions,
    "experiment.valve",
    "Examples: retuner experiment valve examples/oven.toml --step 0.5 --hold 120; "
    "retuner experiment valve --from valve.csv",
)
