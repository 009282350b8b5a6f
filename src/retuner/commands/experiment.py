"""retuner experiment step|setpoint|relay|ultimate|valve: on demand against a controller, with limits, restored
afterwards; or the evaluation of a recorded one (--from FILE).
"""

import json
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from retuner.adaptive.experiments.plan import Experiment, Plan
from retuner.adaptive.experiments.valve_test import SHORT, STAIRCASE, read_valve_test
from retuner.adaptive.explanations.proposed_test import TestKind
from retuner.adaptive.rules.registry import rule_named
from retuner.commands.options import check_plot, on_bus, tell
from retuner.commands.recorded.recorded_loop import read_record, tell_assumed
from retuner.commands.signatures import (
    ControllerOptions,
    OnDemandOptions,
    RecordedOptions,
    RelayOptions,
    SetpointOptions,
    StepOptions,
    UltimateOptions,
    ValveOptions,
)
from retuner.config import Config, load_config
from retuner.config.bench_plants import plant_of
from retuner.decision_page.svg import drawn
from retuner.drivers.device import Bench, DeviceError
from retuner.drivers.recorded.recording import require_excitation, require_setpoint
from retuner.errors import UserError, user_input
from retuner.experiment.drawing import experiment_figure
from retuner.experiment.findings import (
    LIKELY,
    METHODS,
    OVERSHOOT_RULE,
    ULTIMATE,
    ExperimentQuestion,
    described,
    evaluate,
    headline,
    valve_described,
)
from retuner.experiment.on_demand import RECORD, OnDemandExperiment
from retuner.experiment.target import DEFAULT_DEVIATION, DEFAULT_SAMPLES, DEFAULT_SHARE, REST_WAIT_SAMPLES
from retuner.files import write_whole
from retuner.ledger import Ledger
from retuner.report.console import RunScreen, screen_console
from retuner.session.bench_or_buses import live, simulated
from retuner.session.outputs import BUS_LOG, LEDGER, fresh_folder, give_back
from retuner.session.running import real_time_speed
from retuner.stopping import stoppable
from retuner.verbosity import quiet

LARGEST_VALVE_STEP = 5.0  # largest small step, percent of co


class ExperimentSignal(NamedTuple):
    """What a test does to the loop. amplitude : co percent (setpoint: pv units), None for the default share."""

    amplitude: float | None = None
    cycles: int = 4
    bias: float = 0.0
    hysteresis: float | None = None
    kc0: float | None = None
    hold_s: float = 0.0
    moves: tuple[int, ...] = ()


def step(options: StepOptions) -> int:
    """A step of co; the exit status."""
    return _test(Experiment.STEP, options, question_for(Experiment.STEP, options), ExperimentSignal(options.amplitude))


def setpoint(options: SetpointOptions) -> int:
    """A step of the setpoint; the exit status."""
    amplitude, hold_s = options.amplitude, options.hold
    if options.from_diagnosis is not None:
        if amplitude is not None or hold_s:
            raise UserError("--from-diagnosis has amplitude and hold: leave out --amplitude and --hold")
        amplitude, hold_s = proposed(options.from_diagnosis)
    if hold_s and (options.kc0 is not None or options.file is not None):
        raise UserError("--hold: the test runs under the active gains; leave out --kc0 and --from")
    question = question_for(Experiment.SETPOINT, options, options.kc0)
    return _test(Experiment.SETPOINT, options, question, ExperimentSignal(amplitude, kc0=options.kc0, hold_s=hold_s))


def proposed(path: Path) -> tuple[float, float]:
    """Size and hold of the setpoint test that a diagnosis proposes. path : what `retuner diagnose --json` printed.

    Raises UserError: it cannot be read, or proposes no such test.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))["next"]
        kind, size, hold_s = told["kind"], float(told["size"]), float(told["hold_s"])
    except (OSError, ValueError, KeyError, TypeError):
        raise UserError(
            f"--from-diagnosis {path}: no test in it; give what `retuner diagnose --json` printed"
        ) from None
    if kind != TestKind.SETPOINT:
        command = f"retuner experiment valve CONFIG --step {size:g} --hold {hold_s:g} --short"
        raise UserError(f"--from-diagnosis {path}: it proposes a {kind} test: {command}")
    return size, hold_s


def relay(options: RelayOptions) -> int:
    """Relay feedback; the exit status."""
    question = question_for(Experiment.RELAY, options, None, options.hysteresis)
    shape = ExperimentSignal(options.amplitude, options.cycles, options.bias, options.hysteresis)
    return _test(Experiment.RELAY, options, question, shape)


def ultimate(options: UltimateOptions) -> int:
    """A recorded swing; the exit status."""
    return from_recording(options.file, options, question_for(ULTIMATE, options, options.kc))


def _test(kind: Experiment, options: OnDemandOptions, question: ExperimentQuestion, shape: ExperimentSignal) -> int:
    if options.file is not None and options.config is not None:
        raise UserError("give CONFIG to run the test, or --from FILE to evaluate a recording, not both")
    if options.file is not None:
        return from_recording(options.file, options, question)
    if options.config is None:
        raise UserError(f"give CONFIG to run the test, or --from FILE; `retuner experiment {kind} --help`")
    return on_demand(options.config, kind, options, question, shape)


def from_recording(file: Path, options: RecordedOptions, question: ExperimentQuestion) -> int:
    """Evaluate a recorded experiment and show it; the exit status: 0, or 1 when it carries no settings.

    Raises UserError, RecordingError: the file or an option cannot be used.
    """
    check_plot(options.plot)
    read = read_record([file], options)
    tell_assumed(read.assumed, options)
    recording = read.recording
    if question.kind != ULTIMATE:
        require_excitation(recording)
    if question.kind == Experiment.SETPOINT:
        require_setpoint(recording)
    window = recording.window()
    found = evaluate(window, question)
    if options.plot is not None:
        title = f"{file.name}: {headline(found)}"
        picture = experiment_figure(window, found, title, "pv unit", None)
        write_whole(options.plot, drawn(picture, title, options.plot.suffix))
    if options.as_json:
        sys.stdout.write(json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n")
    else:
        Console(highlight=False, soft_wrap=True, markup=False).print("\n".join(described(found)))
    return 0 if found.usable else 1


def question_for(
    experiment: str, options: RecordedOptions, kc: float | None = None, hysteresis: float | None = None
) -> ExperimentQuestion:
    """The question that the options ask of a record.

    Raises UserError: a number is out of its range, or a method or rule is not known.
    """
    method, rule = options.method, options.rule
    if method not in METHODS[experiment]:
        raise UserError(f"--method {method}: {experiment} has {', '.join(METHODS[experiment])}")
    if kc is not None and not 0 < abs(kc) < float("inf"):
        raise UserError(f"the gain of the experiment is {kc:g}; give a finite gain other than 0")
    if hysteresis is not None and not 0 <= hysteresis < float("inf"):
        raise UserError(f"--hysteresis {hysteresis:g}: give 0 or a positive number of pv units")
    if rule != OVERSHOOT_RULE:
        with user_input(f"--rule {rule}"):
            rule_named(rule)
    at_rest = experiment != Experiment.SETPOINT
    return ExperimentQuestion(experiment, method, rule, options.kind, kc, hysteresis or 0.0, from_rest=at_rest)


def on_demand(
    path: Path, kind: Experiment, options: ControllerOptions, question: ExperimentQuestion, shape: ExperimentSignal
) -> int:
    """Conduct an experiment, evaluate it, and write the settings if they are confirmed; the exit status.

    Raises ConfigError, UserError, DeviceError: the configuration, an option, the folder or the bus cannot be used;
    nothing was changed.
    """
    yes = isinstance(options, OnDemandOptions) and options.yes
    config = on_bus(load_config(path, options.loop), options.interface, options.channel)
    in_process = config.bus.interface == "virtual"
    if in_process:
        plant_of(config)
    speed = real_time_speed(options.speed, simulated=in_process)
    plan = plan_for(config, kind, options, shape)
    folder = options.out or Path(f"{config.output.directory}-experiment")
    console = screen_console(stderr=options.as_json)
    screen = RunScreen(console, config.loop.pv_unit, quiet=options.as_json, answers_only=quiet())
    fresh = fresh_folder(folder)
    try:
        with stoppable(), Ledger(folder / LEDGER) as ledger, screen:
            log = folder / BUS_LOG
            place: AbstractContextManager[Bench] = (
                simulated(config, screen.say, log) if in_process else live(config, speed, log)
            )
            with place as bench:
                return OnDemandExperiment(
                    config, plan, question, folder, ledger, screen, bench, yes=yes, as_json=options.as_json
                ).run()
    except (DeviceError, UserError):
        if not (folder / RECORD).exists():  # nothing happened: leave no folder behind
            give_back(fresh)
        raise


def plan_for(config: Config, kind: Experiment, options: ControllerOptions, shape: ExperimentSignal) -> Plan:
    """The plan that options and configuration make. Raises UserError: an option is out of its range."""
    loop, dt = config.loop, config.loop.sample_time_s
    span = loop.pv_max - loop.pv_min
    range_ = span if kind == Experiment.SETPOINT else loop.co_max_pct - loop.co_min_pct
    with user_input(f"retuner experiment {kind}"):
        return Plan(
            kind=kind,
            amplitude=_or(shape.amplitude, DEFAULT_SHARE * range_),
            pv_low=_or(options.pv_low, loop.pv_min),
            pv_high=_or(options.pv_high, loop.pv_max),
            deviation=_or(options.deviation, DEFAULT_DEVIATION * span),
            co_low=loop.co_min_pct,
            co_high=loop.co_max_pct,
            time_s=_or(options.time, DEFAULT_SAMPLES * dt + (len(shape.moves) or 2) * shape.hold_s),
            rest_time_s=_or(options.rest, REST_WAIT_SAMPLES * dt),
            cycles=shape.cycles,
            bias=shape.bias,
            hysteresis=shape.hysteresis,
            kc0=shape.kc0,
            hold_s=shape.hold_s,
            moves=shape.moves,
        )


def _or(given: float | None, default: float) -> float:
    return default if given is None else given


# ---- the valve test


def valve(options: ValveOptions) -> int:
    """Make the test, show its moves, or evaluate a record; the exit status: 0, or 1 when the valve stays open.

    Raises UserError, RecordingError: an option or the record cannot be used, or it is no valve test.
    """
    if options.config is not None:
        if options.file is not None:
            raise UserError("give CONFIG to run the test, or --from FILE to evaluate a record, not both")
        if options.hold is None:
            raise UserError(
                "--hold: missing; give the seconds for which each step is held: four times the time to half"
            )
        shape = ExperimentSignal(_valve_step(options), hold_s=options.hold, moves=SHORT if options.short else STAIRCASE)
        return on_demand(options.config, Experiment.VALVE, options, ExperimentQuestion(Experiment.VALVE), shape)
    if options.file is None:
        step = _valve_step(options)
        told: list[tuple[int, float]] = []
        for move in SHORT if options.short else STAIRCASE:
            if told and told[-1][1] == move * step:
                told[-1] = (told[-1][0] + 1, told[-1][1])
            else:
                told.append((1, move * step))
        moves = ", ".join(f"{count} x {move:+g}" if count > 1 else f"{move:+g}" for count, move in told)
        lines = [
            "In manual, move co by these steps; hold each for four times the time to half of pv's change:",
            f"  {moves}",
            "Record time, co and pv, then: retuner experiment valve --from FILE",
            "On a controller that is configured: retuner experiment valve CONFIG --step STEP --hold SECONDS",
        ]
        sys.stdout.write("\n".join(lines) + "\n")
        return 0
    read = read_record([options.file], options)
    tell_assumed(read.assumed, options)
    with user_input(str(options.file)):
        found = read_valve_test(read.recording.window())
    tell(found.to_dict(), valve_described(found), as_json=options.as_json)
    return 0 if max(found.sound, found.dead_band_odds, found.resolution_odds) >= LIKELY else 1


def _valve_step(options: ValveOptions) -> float:
    if not 0.0 < options.step <= LARGEST_VALVE_STEP:
        raise UserError(
            f"--step {options.step:g}: give a small step of co, above 0 and at most {LARGEST_VALVE_STEP:g} percent"
        )
    return options.step
