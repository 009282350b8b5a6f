"""retuner experiment step|setpoint|relay|ultimate --from FILE: the evaluation of a recorded experiment."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from retuner.adaptive.experiments.plan import Kind
from retuner.adaptive.rules.registry import rule_named
from retuner.commands.recorded_loop import renamed
from retuner.drivers.recorded.recording import read_recording, require_excitation, require_setpoint
from retuner.errors import UserError, user_input
from retuner.experiment.drawing import experiment_png
from retuner.experiment.findings import METHODS, OVERSHOOT_RULE, ULTIMATE, Question, described, evaluate, headline
from retuner.files import write_whole


@dataclass(frozen=True, slots=True)
class Recorded:
    """Where a recorded experiment is, and how to show it."""

    file: Path
    columns: str = ""
    plot: Path | None = None
    as_json: bool = False


def from_recording(recorded: Recorded, question: Question) -> int:
    """Evaluate a recorded experiment and show it; the exit status: 0, or 1 when it carries no settings.

    Raises
    ------
    UserError, RecordingError
        The file or an option cannot be used.
    """
    recording = read_recording(recorded.file, renamed(recorded.columns))
    if question.kind != ULTIMATE:
        require_excitation(recording)
    if question.kind == Kind.SETPOINT:
        require_setpoint(recording)
    window = recording.window()
    found = evaluate(window, question)
    if recorded.plot is not None:
        title = f"{recorded.file.name}: {headline(found)}"
        write_whole(recorded.plot, experiment_png(window, found, title, "pv unit", None))
    if recorded.as_json:
        sys.stdout.write(json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n")
    else:
        Console(highlight=False, soft_wrap=True, markup=False).print("\n".join(described(found)))
    return 0 if found.usable else 1


def question_for(
    kind: str, method: str, rule: str, controller: str | None, kc: float | None = None, hysteresis: float | None = None
) -> Question:
    """The question that the options ask of a record.

    Raises
    ------
    UserError
        A number is out of its range, or a method or rule is not known.
    """
    if method not in METHODS[kind]:
        raise UserError(f"--method {method}: {kind} has {', '.join(METHODS[kind])}")
    if kc is not None and not 0 < abs(kc) < float("inf"):
        raise UserError(f"the gain of the experiment is {kc:g}; give a finite gain other than 0")
    if hysteresis is not None and not 0 <= hysteresis < float("inf"):
        raise UserError(f"--hysteresis {hysteresis:g}: give 0 or a positive number of pv units")
    if rule != OVERSHOOT_RULE:
        with user_input(f"--rule {rule}"):
            rule_named(rule)
    return Question(kind, method, rule, controller, kc, hysteresis or 0.0, from_rest=kind != Kind.SETPOINT)
