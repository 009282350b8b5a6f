"""retuner experiment valve: a valve test on a controller or by hand, and what its record says."""

import json
import sys

from retuner.adaptive.experiments.plan import Kind
from retuner.adaptive.experiments.valve_test import SHORT, STAIRCASE, read_valve_test
from retuner.commands.recorded.record_form import read_record, tell_assumed
from retuner.commands.work.experiment import ExperimentSignal, on_demand
from retuner.commands.work.experiment_options import ValveOptions
from retuner.errors import UserError, user_input
from retuner.experiment.findings import LIKELY, Question, valve_described

LARGEST = 5.0
"""Of a small step, percent of co."""


def valve(options: ValveOptions) -> int:
    """Make the test, show its moves, or evaluate a record; the exit status: 0, or 1 when the valve stays open.

    Raises
    ------
    UserError, RecordingError
        An option or the record cannot be used, or it is no valve test.
    """
    if options.config is not None:
        return _on_controller(options)
    if options.file is None:
        sys.stdout.write("\n".join(_moves(options)) + "\n")
        return 0
    read = read_record([options.file], options)
    tell_assumed(read.assumed, options)
    with user_input(str(options.file)):
        found = read_valve_test(read.recording.window())
    if options.as_json:
        sys.stdout.write(json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("\n".join(valve_described(found)) + "\n")
    decided = max(found.sound, found.dead_band_odds, found.resolution_odds) >= LIKELY
    return 0 if decided else 1


def _on_controller(options: ValveOptions) -> int:
    """The test on the controller of a configuration; the exit status."""
    assert options.config is not None
    if options.file is not None:
        raise UserError("give CONFIG to run the test, or --from FILE to evaluate a record, not both")
    if options.hold is None:
        raise UserError("--hold: missing; give the seconds for which each step is held: four times the time to half")
    shape = ExperimentSignal(_step(options), hold_s=options.hold, moves=SHORT if options.short else STAIRCASE)
    return on_demand(options.config, Kind.VALVE, options, Question(Kind.VALVE), shape)


def _step(options: ValveOptions) -> float:
    """The small step."""
    if not 0.0 < options.step <= LARGEST:
        raise UserError(f"--step {options.step:g}: give a small step of co, above 0 and at most {LARGEST:g} percent")
    return options.step


def _moves(options: ValveOptions) -> list[str]:
    """What a person does at the controller."""
    step = _step(options)
    told: list[tuple[int, float]] = []
    for move in SHORT if options.short else STAIRCASE:
        if told and told[-1][1] == move * step:
            told[-1] = (told[-1][0] + 1, told[-1][1])
        else:
            told.append((1, move * step))
    moves = ", ".join(f"{count} x {move:+g}" if count > 1 else f"{move:+g}" for count, move in told)
    return [
        "In manual, move co by these steps; hold each for four times the time to half of pv's change:",
        f"  {moves}",
        "Record time, co and pv, then: retuner experiment valve --from FILE",
        "On a controller that is configured: retuner experiment valve CONFIG --step STEP --hold SECONDS",
    ]
