"""What can be typed of each command that loads much: its options with their help. Its work, in commands/, is loaded
when it is called, so that `--help` does not wait for that.
"""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar, dataclass_transform

import typer

from retuner.audit import AREA
from retuner.commands.options import (
    ActionOption,
    By,
    Channel,
    ConfigFile,
    Controller,
    FormOptions,
    Interface,
    Json,
    Loop,
    Note,
    Plot,
    PvSpan,
    RecordOptions,
    Session,
    argument,
    command,
    option,
)
from retuner.schedule.late_dataclass import dataclass

Options = TypeVar("Options")
GROUPS = {
    "ledger": ("Read, verify, export or revert what was seen, decided and written.", "ledger show runs/demo"),
    "experiment": (
        "Make a step, setpoint or relay test, or evaluate a recorded one.",
        "experiment relay examples/oven.toml --amplitude 5",
    ),
}
"""Commands with commands of their own: their help, and an example."""


class Typed(NamedTuple):
    """options : dataclass whose fields are the options. work : module in commands/, and its function."""

    options: type
    work: str
    example: str


TYPED: dict[str, list[Typed]] = defaultdict(list)


@dataclass_transform(kw_only_default=True, frozen_default=True)
def typed(work: str, example: str, group: str = "") -> Callable[[type[Options]], type[Options]]:
    """Make a class the options that can be typed of a command, or of a command of that group; its help is the class's
    docstring. work : module in commands/, and its function, which has the command's name.
    """

    def noted(options: type[Options]) -> type[Options]:
        made = dataclass(frozen=True, slots=True, kw_only=True)(options)
        TYPED[group or work.rpartition(".")[2]].append(Typed(made, work, example))
        return made

    return noted


def app_of(name: str, within: str = "") -> typer.Typer:
    """A command, or a group of them, as typer has it; of a group only the command of that name, where it has one."""
    app = typer.Typer(add_completion=False)
    if name in GROUPS:
        about, one = GROUPS[name]
        app = typer.Typer(no_args_is_help=True, add_completion=False, help=about, epilog=f"Example: retuner {one}")
        app.callback()(lambda: None)  # a group, whatever it has
    called = [one for one in TYPED[name] if one.work.endswith(f".{within}")]
    for options, work, example in called or TYPED[name]:
        command(app, options, work, example)
    return app


@typed("init.init", "Example: retuner init oven.toml; or retuner init loop.toml --from trend.csv")
class InitOptions:
    """Write a configuration: a commented starter, or by a few questions, or of a record's loop."""

    path: Path = argument(Path("retuner.toml"), "Where to write it.", metavar="FILE")
    force: bool = option(False, "Replace a file that exists.", "--force")
    profile: str = option("", "For a controller that exists: odrive, cia402, cia404.")
    record: Path | None = option(None, "Of the loop in a record, with its process to try.", "--from", metavar="RECORD")
    kc: float | None = option(None, "With --from: the active gain, % per pv unit, series form.")
    tau_i: float | None = option(None, "With --from: the active integral time, s.")
    tau_d: float = option(0.0, "With --from: the active derivative time, s.")
    ask: bool | None = option(None, "Questions about the loop; asked on a terminal.", "--ask/--no-ask")


@typed("run.run", "Example: retuner run examples/oven.toml --out runs/oven")
class RunOptions:
    """Watch a loop, retune it over CAN, and leave a report."""

    config: ConfigFile
    interface: Interface = None
    channel: Channel = None
    speed: str = option("max", "max: simulated time; a number: how much faster than real time the device runs.")
    mode: str | None = option(None, "off, advise, trial or auto; overrides the configuration.")
    out: Path | None = option(None, "Folder for report, ledger, trend and bus log.")
    compare: bool = option(True, "Also run with fixed gains, where the plant is simulated.")
    pretune: bool = option(False, "Begin with a step test of co, for a first model and gains.", "--pretune")
    verbose: bool = option(False, "On a terminal: the evidence behind each decision.", "--verbose", "-v")
    serve: bool = option(False, "Show it in a browser while it runs.", "--serve")
    as_json: Json = False


@typed(
    "replay.replay", "Example: retuner replay runs/demo; retuner replay loop.csv --config loop.toml --columns pv=temp"
)
class ReplayOptions(FormOptions):
    """Repeat the decisions of a session byte for byte, or apply retuner to a recorded log."""

    target: Annotated[Path, typer.Argument(metavar="SESSION|LOG", help="A session's folder; or, with --config, a log.")]
    config: Path | None = option(
        None, "Apply this configuration to a log (.csv, .parquet, .blf, .asc, .mf4, candump .log)."
    )
    loop: Loop = None
    as_json: Json = False


@typed("report.report", "Example: retuner report runs/demo; retuner report runs/demo --decision 7 --out page.html")
class ReportOptions:
    """Make the report of a recorded session again, or the page of one decision with its full reasoning."""

    session: Session
    decision: int | None = option(None, "Only the page of this decision, by its number.")
    out: Path | None = option(None, "Where to write it; default in the session's folder.")
    loop: Loop = None
    as_json: Json = False


@typed(
    "approve.approve", "Example: retuner approve runs/demo; retuner approve runs/demo 4bebeed6 --note 'as discussed'"
)
class ApproveOptions:
    """Approve a proposal, named by its hash, or list the open ones, the newest of each region.

    A proposed schedule is written into a configuration (--into); its next run uses it.
    """

    session: Session
    digest: str | None = argument(
        None, "Of the proposal, 8 digits or more; without it: list the open ones.", metavar="[HASH]"
    )
    by: By = None
    note: Note = ""
    unlock: str | None = option(None, "Unlock a region.", metavar="REGION")
    every: bool = option(False, "List superseded proposals, too.", "--all")
    into: Path | None = option(None, "Configuration that gets a proposed schedule.", metavar="CONFIG")
    loop: Loop = None
    as_json: Json = False


@typed("recorded.tune.tune", "Example: retuner tune --type fopdt --k 0.361 --tau1 138 --theta 14.2 --rule simc")
class TuneOptions:
    """Compute settings for a known process by a tuning rule, with margins."""

    type: str | None = option(
        None, "fopdt, sopdt, integrating, integrating-lag, double-integrating, delay, sopdt-inverse, sopdt-lead, topdt."
    )
    k: float | None = option(None, "Steady-state gain; slope gain of integrating types.")
    tau1: float = option(0.0, "Lag, s.")
    tau2: float = option(0.0, "Second lag, s.")
    theta: float = option(0.0, "Dead time, s.")
    inverse: float = option(0.0, "Zero b of 1 - b s, s: above 0 an inverse response, below 0 a lead.")
    tau3: float = option(0.0, "Third lag, s (topdt).")
    rule: str = option("simc", "Tuning rule; a wrong name shows the list.")
    kind: str | None = option(None, "p, pi or pid; default pi where the rule has it.")
    form: str | None = option(None, "series, ideal or parallel; default the rule's own.")
    tau_c: float | None = option(None, "Closed-loop time constant (or lambda), s.")
    ms: float | None = option(None, "Demanded Ms (simc rules, optimal).")
    gm: float | None = option(None, "Demanded gain margin (simc rules).")
    c: float | None = option(None, "c in tau_I = min(tau1, c (tau_c + theta)); default 4.")
    u0: float | None = option(None, "Largest disturbance, co units (simc-smooth, averaging).")
    ymax: float | None = option(None, "Deviation allowed, pv units (simc-smooth, averaging).")
    ku: float | None = option(None, "Ultimate gain; from the model if left out.")
    pu: float | None = option(None, "Ultimate period, s.")
    kq: float | None = option(None, "Gain at quarter decay.")
    pq: float | None = option(None, "Period at quarter decay, s.")
    controller: Controller = None
    action: ActionOption = None
    pv_span: float | None = option(None, "Span of pv: also as proportional band, percent, and repeats per minute.")
    everything: bool = option(False, "Every rule that applies, in one table.", "--all")
    explain: bool = option(False, "Also formula, numbers put in and source.", "--explain")
    plot: Path | None = option(
        None, "Draw the responses (.png, .svg); of rule optimal the Pareto curve J against Ms.", metavar="FILE"
    )
    as_json: Json = False


@typed("recorded.identify.identify", "Example: retuner identify heater.csv --open-loop --columns pv=temperature,co=pwm")
class IdentifyOptions(RecordOptions):
    """Identify the process from a record: model, standard deviations and settings."""

    open_loop: bool = option(False, "The loop was in manual.", "--open-loop")
    region_by: str = option("", "A model for each region of pv, sp or co; needs --bounds.")
    bounds: str = option("", "Boundaries of the regions, increasing: 20,40,60.")


@typed(
    "recorded.diagnose.diagnose",
    "Example: retuner diagnose loop.csv --kc 0.8 --tau-i 40 --co-min 0 --co-max 100 --plot loop.png",
)
class DiagnoseOptions(RecordOptions):
    """Find the cause of a loop's behaviour, with evidence and recommended settings."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Records of one loop, oldest first; or one, a file for each signal."),
    ]
    kc: float | None = option(None, "Active controller gain; else identified from the record.")
    aim: str = option("tight", "tight; smooth: as slow as --ymax allows; averaging: a tank moves, its flow does not.")
    ymax: float | None = option(None, "With these aims: how far pv may go, in its unit.")
    u0: float | None = option(None, "For this step of the load, co units; default what co had to move.")
    with_evidence: bool = option(False, "All numbers behind it, and other forms.", "--evidence")


@typed(
    "recorded.schedule.schedule", "Example: retuner schedule examples/records/day.csv --by pv --out runs/oven-schedule"
)
class ScheduleOptions(FormOptions):
    """Find what changes along a variable, and the fewest sets of gains that serve it everywhere."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="RECORD...", help="Records of one loop as exported, or a file for each signal."),
    ]
    by: list[str] | None = option(
        None, "sp, pv, co or any column; of several the evidence chooses 1 or 2.", "--by", metavar="VARIABLE"
    )
    low: float | None = option(None, "Lower end of the first variable; default: as far as the records go.")
    high: float | None = option(None, "Upper end of the first variable.")
    co_min: float | None = option(None, "Lower limit of co, in its own unit.")
    co_max: float | None = option(None, "Upper limit of co.")
    ms: float = option(1.8, "Largest Ms anywhere, over the plausible models; 1.5 to 2.5.")
    j: float = option(1.25, "Largest J over that of a place's own settings; 1.05 to 2.", "--j")
    lookup: str = option("auto", "hard, interpolated or auto.")
    gains: Path | None = option(None, "Gain table active then, to compare; else identified.", metavar="TOML")
    gain_columns: str = option(
        "", "Columns of the active gains, parallel, to compare; kd is optional.", metavar="KP,KI,KD"
    )
    controller: Controller = None
    action: ActionOption = None
    pv_span: PvSpan = None
    name: str = option("", "Name of the loop in the table; default: its tag, else the file's.")
    unit: str = option("", "Unit of the variable.")
    out: Path | None = option(None, "Write gains.toml, schedule.toml and report.html there.", metavar="FOLDER")
    as_json: Json = False


@typed("recorded.audit.audit", "Example: retuner audit trends/ --out audit/ --stretches 6")
class AuditOptions(FormOptions):
    """Rank the loops of a plant by what a visit would bring; nothing is written to any controller."""

    sources: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Folders, files or patterns of trends.")]
    out: Path = option(Path("audit"), "Folder of the page and the results; an audit in it goes on.")
    tag_pattern: str = option("", r"Tag in the names of files without tags: ^([A-Z]+\d+)_", metavar="REGEX")
    stretches: int = option(4, "Stretches of each record that are diagnosed at most, up to 24; 0 screens only.")
    diagnose: float = option(100.0, "Share of the loops that is diagnosed, in percent: the worst by the screening.")
    area: str = option(AREA, "Area in a tag: its first group.", metavar="REGEX")
    controller: Controller = None
    pv_span: PvSpan = None
    since: Path | None = option(None, "Folder of an earlier audit: what became worse?")
    jobs: int = option(0, "Processes; 0: one for each core.")
    scheduler: str = option("", "A dask cluster that does the work.", metavar="ADDRESS")
    as_json: Json = False


@typed("recorded.reduce.reduce", "Example: retuner reduce --num-t 15 --den-t 20,1,0.1,0.1 --k 2 --order 2")
class ReduceOptions:
    """Reduce a process model to first or second order by the half rule."""

    num_t: list[str] | None = option(None, "Numerator time constants, s; negative: inverse response.", "--num-t")
    den_t: list[str] | None = option(None, "Lags, s, separated by commas.", "--den-t")
    integrators: int = option(0, "Pure integrators.")
    delay: float = option(0.0, "Dead time, s.")
    order: int = option(1, "Order of the model: 1 for PI, 2 for PID.")
    k: float = option(1.0, "Steady-state gain; slope gain per second with an integrator.")
    leads: str = option("auto", "auto; rules: T1 to T3 for all positive numerator time constants; subtract: none.")
    as_json: Json = False


@typed("ledger.verify", "Example: retuner ledger verify runs/demo/ledger.sqlite --head 61f2ae1c0d3b", group="ledger")
class VerifyOptions:
    """Recompute the hash chain: status 0 when it holds, 1 when it is broken, and where."""

    file: Annotated[Path, typer.Argument(metavar="SESSION", help="Folder of a run, or the ledger.sqlite in it.")]
    head: str | None = option(None, "Hash that was noted when it was written; cut-off rows show.")
    as_json: Json = False


@typed("ledger.show", "Example: retuner ledger show runs/demo --decision 3", group="ledger")
class ShowOptions:
    """Who, when, why, from what to what, on what evidence, with what verdict: row by row."""

    session: Session
    decision: int | None = option(None, "Only this decision and what came of it.")
    since: float | None = option(None, "Only from this time of the run on, s.")
    kind: str | None = option(None, "Only rows of this kind: decision, order, committed, ...")
    loop: Loop = None
    as_json: Json = False


@typed("ledger.export", "Example: retuner ledger export runs/demo --csv demo.csv", group="ledger")
class ExportOptions:
    """Write the rows into a file for other programs."""

    session: Session
    as_csv: Path | None = option(None, "A table for a spreadsheet.", "--csv", metavar="FILE")
    as_jsonl: Path | None = option(None, "One JSON document a line, whole.", "--jsonl", metavar="FILE")


@typed("approve.revert", "Example: retuner ledger revert runs/demo --decision 3 --note 'pump changed'", group="ledger")
class RevertOptions:
    """Request a rollback to the gains before a decision, in its region, by the running or the next session."""

    session: Session
    decision: Annotated[int, typer.Option("--decision", "--to", help="Back to the gains before this decision.")]
    by: By = None
    note: Note = ""
    loop: Loop = None
    as_json: Json = False


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


@typed(
    "experiment.step",
    "Examples: retuner experiment step examples/oven.toml --amplitude 5; "
    "retuner experiment step --from heater.csv --columns pv=temperature",
    group="experiment",
)
class StepOptions(OnDemandOptions):
    """Open-loop step of the output. Methods: fit, two-point, tangent, reaction-curve, 63-percent, slope."""

    amplitude: float | None = option(None, "Step of co, percent; default 5 % of its range.")


@typed(
    "experiment.setpoint",
    "Examples: retuner experiment setpoint examples/oven.toml --amplitude 5 --kc0 1.5; "
    "retuner experiment setpoint --from loop.csv --kc0 1.5 --rule setpoint-overshoot",
    group="experiment",
)
class SetpointOptions(OnDemandOptions):
    """Setpoint step under proportional control, or with --hold out and back under the active gains, for `diagnose`.

    Methods: fit, two-step; --rule setpoint-overshoot needs no model.
    """

    amplitude: float | None = option(None, "Step of sp, pv units; default 5 % of the range.")
    kc0: float | None = option(None, "Proportional gain of the test; default the active one.")
    hold: float = option(0.0, "Out for so long and back, s, under the active gains.")
    from_diagnosis: Path | None = option(None, "The test that `retuner diagnose --json` proposed.", metavar="FILE")


@typed(
    "experiment.relay",
    "Examples: retuner experiment relay examples/oven.toml --amplitude 10 --bias 0.3; "
    "retuner experiment relay --from relay.csv --rule zn-ultimate --kind pid",
    group="experiment",
)
class RelayOptions(OnDemandOptions):
    """Relay feedback: Ku and Pu, and a model. Methods: fit, asymmetric; rules zn-ultimate ... take Ku and Pu."""

    amplitude: float | None = option(None, "Of the relay, percent of co; default 5 % of range.")
    bias: float = option(0.3, "Asymmetry, 0 to 0.8; some lets the process gain show.")
    hysteresis: float | None = option(None, "Pv units; default 3 x the noise seen at rest.")
    cycles: int = option(4, "Full waves that count, 2 to 50.")


@typed("experiment.ultimate", "Example: retuner experiment ultimate --from swing.csv --kc 3.2", group="experiment")
class UltimateOptions(RecordedOptions):
    """A swing under proportional control: its period, and whether the gain was the ultimate one."""

    file: Annotated[Path, typer.Option("--from", metavar="FILE", help="Recording of the swing.")]
    kc: float | None = option(None, "Proportional gain under which it swung.")
    rule: Rule = "zn-ultimate"


@typed(
    "experiment.valve",
    "Examples: retuner experiment valve examples/oven.toml --step 0.5 --hold 120; "
    "retuner experiment valve --from valve.csv",
    group="experiment",
)
class ValveOptions(FormOptions, ControllerOptions):
    """Small steps of co up and down in manual: resolution, dead band and stroke of the valve, with their odds."""

    file: Path | None = option(None, "Evaluate this record; alone: show the moves.", "--from", metavar="FILE")
    step: float = option(0.5, "Small step, percent of co.")
    hold: float | None = option(None, "Hold each for so long, s: four times the time to half of pv's change.")
    short: bool = option(False, "Up, up, down, down only: for `diagnose`.", "--short")
