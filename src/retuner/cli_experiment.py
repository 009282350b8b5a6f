"""`retuner experiment ...`: signatures and help only, as in cli.py."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    no_args_is_help=True,
    help="A step, setpoint or relay test: on demand, or from a recording.",
    epilog="Example: retuner experiment relay examples/oven.toml --amplitude 5",
)

Config = Annotated[
    Path | None, typer.Argument(metavar="[CONFIG]", help="Configuration (TOML): run the test on its controller.")
]
From = Annotated[Path | None, typer.Option("--from", metavar="FILE", help="Evaluate this recording instead.")]
Columns = Annotated[str, typer.Option(help="Other names in the recording: t=time,pv=temp,co=out,sp=target.")]
Plot = Annotated[Path | None, typer.Option(metavar="PNG", help="Draw the recording.")]
Method = Annotated[str, typer.Option(help="Whose model is tuned for; fit, or a named method of this test.")]
Rule = Annotated[str, typer.Option(help="Tuning rule.")]
Kind = Annotated[str | None, typer.Option("--kind", help="p, pi or pid, as the rule has it.")]
Interface = Annotated[str | None, typer.Option("--interface", "-i", help="As python-can spells it.")]
Channel = Annotated[str | None, typer.Option("--channel", "-c", help="Channel of the interface.")]
Speed = Annotated[str, typer.Option(help="max: simulated time; a number: how fast the far side's time runs.")]
Out = Annotated[Path | None, typer.Option(help="Folder for record, picture, ledger and bus log.")]
Yes = Annotated[bool, typer.Option("--yes", help="The settings are confirmed: write them.")]
PvLow = Annotated[float | None, typer.Option(help="Abort below this pv; default the loop's range.")]
PvHigh = Annotated[float | None, typer.Option(help="Abort above this pv; default the loop's range.")]
Deviation = Annotated[float | None, typer.Option(help="Abort so far from rest, pv units; default 20 % of the range.")]
Time = Annotated[float | None, typer.Option("--time", help="Longest excitation, s; default 2000 samples.")]
Rest = Annotated[float | None, typer.Option("--rest", help="Longest wait for rest, s; default 300 samples.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


def _dispatch(config: Path | None, recorded: object, question: object, options: object) -> int:
    """A recording, or a controller."""
    from retuner.commands.experiment import Recorded, from_recording
    from retuner.commands.experiment_on_demand import OnDemand, on_demand
    from retuner.errors import UserError
    from retuner.experiment.findings import Question

    assert isinstance(question, Question)
    if isinstance(recorded, Recorded) and config is None:
        return from_recording(recorded, question)
    if recorded is not None:
        raise UserError("give CONFIG to run the test, or --from FILE to evaluate a recording, not both")
    if config is None:
        raise UserError(f"give CONFIG to run the test, or --from FILE; `retuner experiment {question.kind} --help`")
    assert isinstance(options, OnDemand)
    from retuner.adaptive.experiments.plan import Kind as ExperimentKind

    return on_demand(config, ExperimentKind(question.kind), options, question)


@app.command(
    epilog="Examples: retuner experiment step examples/oven.toml --amplitude 5; "
    "retuner experiment step --from heater.csv --columns pv=temperature"
)
def step(
    config: Config = None,
    file: From = None,
    columns: Columns = "",
    plot: Plot = None,
    method: Method = "fit",
    rule: Rule = "simc",
    kind: Kind = None,
    interface: Interface = None,
    channel: Channel = None,
    speed: Speed = "max",
    amplitude: Annotated[float | None, typer.Option(help="Step of co, percent; default 5 % of its range.")] = None,
    pv_low: PvLow = None,
    pv_high: PvHigh = None,
    deviation: Deviation = None,
    time: Time = None,
    rest: Rest = None,
    out: Out = None,
    yes: Yes = False,
    json: Json = False,
) -> int:
    """Open-loop step of the output. Methods: fit, two-point, tangent, reaction-curve, 63-percent, slope."""
    from retuner.commands.experiment import Recorded, question_for
    from retuner.commands.experiment_on_demand import OnDemand

    question = question_for("step", method, rule, kind)
    options = OnDemand(interface, channel, speed, out, yes, json, amplitude, pv_low, pv_high, deviation, time, rest)
    return _dispatch(config, Recorded(file, columns, plot, json) if file else None, question, options)


@app.command(
    epilog="Examples: retuner experiment setpoint examples/oven.toml --amplitude 5 --kc0 1.5; "
    "retuner experiment setpoint --from loop.csv --kc0 1.5 --rule setpoint-overshoot"
)
def setpoint(
    config: Config = None,
    file: From = None,
    columns: Columns = "",
    plot: Plot = None,
    method: Method = "fit",
    rule: Rule = "simc",
    kind: Kind = None,
    interface: Interface = None,
    channel: Channel = None,
    speed: Speed = "max",
    amplitude: Annotated[float | None, typer.Option(help="Step of sp, pv units; default 5 % of the range.")] = None,
    kc0: Annotated[float | None, typer.Option(help="Proportional gain of the test; default that in force.")] = None,
    pv_low: PvLow = None,
    pv_high: PvHigh = None,
    deviation: Deviation = None,
    time: Time = None,
    rest: Rest = None,
    out: Out = None,
    yes: Yes = False,
    json: Json = False,
) -> int:
    """Setpoint step under proportional control. Methods: fit, two-step; --rule setpoint-overshoot needs no model."""
    from retuner.commands.experiment import Recorded, question_for
    from retuner.commands.experiment_on_demand import OnDemand

    question = question_for("setpoint", method, rule, kind, kc0)
    options = OnDemand(
        interface, channel, speed, out, yes, json, amplitude, pv_low, pv_high, deviation, time, rest, kc0=kc0
    )
    return _dispatch(config, Recorded(file, columns, plot, json) if file else None, question, options)


@app.command(
    epilog="Examples: retuner experiment relay examples/oven.toml --amplitude 10 --bias 0.3; "
    "retuner experiment relay --from relay.csv --rule zn-ultimate --kind pid"
)
def relay(
    config: Config = None,
    file: From = None,
    columns: Columns = "",
    plot: Plot = None,
    method: Method = "fit",
    rule: Rule = "simc",
    kind: Kind = None,
    interface: Interface = None,
    channel: Channel = None,
    speed: Speed = "max",
    amplitude: Annotated[float | None, typer.Option(help="Of the relay, percent of co; default 5 % of range.")] = None,
    bias: Annotated[float, typer.Option(help="Asymmetry, 0 to 0.8; some lets the process gain show.")] = 0.3,
    hysteresis: Annotated[float | None, typer.Option(help="Pv units; default 3 x the noise seen at rest.")] = None,
    cycles: Annotated[int, typer.Option(help="Full waves that count, 2 to 50.")] = 4,
    pv_low: PvLow = None,
    pv_high: PvHigh = None,
    deviation: Deviation = None,
    time: Time = None,
    rest: Rest = None,
    out: Out = None,
    yes: Yes = False,
    json: Json = False,
) -> int:
    """Relay feedback: Ku and Pu, and a model. Methods: fit, asymmetric; rules zn-ultimate ... take Ku and Pu."""
    from retuner.commands.experiment import Recorded, question_for
    from retuner.commands.experiment_on_demand import OnDemand

    question = question_for("relay", method, rule, kind, None, hysteresis)
    options = OnDemand(interface, channel, speed, out, yes, json, amplitude, pv_low, pv_high, deviation, time, rest,
                       cycles, bias, hysteresis)  # fmt: skip
    return _dispatch(config, Recorded(file, columns, plot, json) if file else None, question, options)


@app.command(epilog="Example: retuner experiment ultimate --from swing.csv --kc 3.2")
def ultimate(
    file: Annotated[Path, typer.Option("--from", metavar="FILE", help="Recording of the swing.")],
    columns: Columns = "",
    plot: Plot = None,
    kc: Annotated[float | None, typer.Option(help="Proportional gain under which it swung.")] = None,
    rule: Rule = "zn-ultimate",
    kind: Kind = None,
    json: Json = False,
) -> int:
    """A swing under proportional control: its period, and whether the gain was the ultimate one."""
    from retuner.commands.experiment import Recorded, question_for

    return _dispatch(None, Recorded(file, columns, plot, json), question_for("ultimate", "fit", rule, kind, kc), None)
