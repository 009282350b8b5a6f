"""retuner experiment valve: the moves of a valve test to make by hand, and what its record says."""

import json
import sys

from retuner.adaptive.experiments.valve_test import STAIRCASE, ValveReading, read_valve_test
from retuner.commands.recorded.record_form import read_record, tell_assumed
from retuner.commands.work.experiment_options import ValveOptions
from retuner.errors import UserError, user_input

LIKELY = 0.9
"""Odds from which a fault is named first."""


def valve(options: ValveOptions) -> int:
    """Show the moves, or evaluate a record; the exit status: 0, or 1 when the record leaves the valve open.

    Raises
    ------
    UserError, RecordingError
        An option or the record cannot be used, or it is no valve test.
    """
    if options.file is None:
        sys.stdout.write("\n".join(_moves(options.step)) + "\n")
        return 0
    read = read_record([options.file], options)
    tell_assumed(read.assumed, options)
    with user_input(str(options.file)):
        found = read_valve_test(read.recording.window())
    if options.as_json:
        sys.stdout.write(json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("\n".join(_described(found)) + "\n")
    decided = max(found.sound, found.dead_band_odds, found.resolution_odds) >= LIKELY
    return 0 if decided else 1


def _moves(step: float) -> list[str]:
    """What a person does at the controller."""
    if not 0.0 < step <= 5.0:
        raise UserError(f"--step {step:g}: give a small step of co, above 0 and at most 5 percent")
    told: list[tuple[int, float]] = []
    for move in STAIRCASE:
        if told and told[-1][1] == move * step:
            told[-1] = (told[-1][0] + 1, told[-1][1])
        else:
            told.append((1, move * step))
    moves = ", ".join(f"{count} x {move:+g}" if count > 1 else f"{move:+g}" for count, move in told)
    return [
        "in manual, steps of co; wait after each until pv settles (four times the time to half of its change):",
        f"  {moves}",
        "record time, co and pv, and evaluate: retuner experiment valve --from FILE",
    ]


def _described(found: ValveReading) -> list[str]:
    """The finding in lines."""
    lines = [f"SOUND ({_odds(found.sound)}): the valve follows steps of {found.step:.3g}"]
    if found.sound < 1.0 - LIKELY:
        lines = ["THE VALVE DOES NOT FOLLOW: see its positioner, packing and linkage"]
    elif found.sound < LIKELY:
        lines = [f"OPEN (sound {_odds(found.sound)}): repeat it with larger steps, or hold them longer"]
    for name, value, ends, odds in (
        ("dead band", found.dead_band, found.dead_band_range, found.dead_band_odds),
        ("resolution", found.resolution, found.resolution_range, found.resolution_odds),
    ):
        least = f"below {found.step:.3g}, the step of the test" if name == "resolution" else "none"
        seen = f"{value:.3g} of co ({ends[0]:.3g} to {ends[1]:.3g})" if odds > 1.0 - LIKELY else least
        lines.append(f"  {name:<11}{seen}; {_odds(odds)} that there is one")
    if found.stroke_s is not None:
        lines.append(f"  {'stroke':<11}at most {found.stroke_s:.3g} s for the whole range")
    return lines


def _odds(p: float) -> str:
    return "over 99 %" if p > 0.99 else "under 1 %" if p < 0.01 else f"{p:.0%}".replace("%", " %")
