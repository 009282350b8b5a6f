"""retuner diagnose: what is behind a loop's behaviour, with the evidence, and the settings that would cure it.

Where the settings in force are not given they are read off the record (adaptive/controller_settings/read_off.py):
without them nothing can be said of the tuning.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner import api
from retuner.adaptive.controller_settings.read_off import SettingsInForce, settings_in_force
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.adaptive.diagnosis.enough_data import shortcomings
from retuner.adaptive.indexes.screening import Screening, screen
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.visual import oscillation_by_eye, sampling_by_eye
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window
from retuner.api import RecordDiagnosis
from retuner.commands.options import signed_by
from retuner.commands.recorded.record_form import tell_assumed
from retuner.commands.recorded.recorded_loop import (
    RecordOptions,
    controller,
    read_loop,
    require_direction,
    require_length,
)
from retuner.decision_page.evidence_words import REGULAR, evidence_lines
from retuner.decision_page.explain import settings_text
from retuner.decision_page.shown_units import chosen_units
from retuner.drivers.recorded.recording import Recording
from retuner.errors import user_input
from retuner.files import write_whole
from retuner.schedule.gains import PidGains
from retuner.tuning import tuning_lines
from retuner.verbosity import busy

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True)
class DiagnosedRecord:
    """A diagnosed record with everything that is shown.

    gains : the settings in force, given or read off. read_off : how they were, None when they were given.
    evidence : numbers by name, of the indexes and of the diagnosis. notes : what the record lacks.
    """

    source: str
    window: Window
    result: RecordDiagnosis
    gains: PidGains | None
    read_off: SettingsInForce | None
    seen: Screening
    evidence: dict[str, float]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnoseOptions(RecordOptions):
    """Find the cause of a loop's behaviour, with evidence and recommended settings."""

    kc: Annotated[float | None, typer.Option(help="Active controller gain; else identified from the record.")] = None


@app.command(epilog="Example: retuner diagnose loop.csv --kc 0.8 --tau-i 40 --co-min 0 --co-max 100 --plot loop.png")
@signed_by(DiagnoseOptions)
def diagnose(options: DiagnoseOptions) -> int:
    """Diagnose and show; the exit status: 0, or 1 when no cause can be named.

    Raises
    ------
    UserError, RecordingError
        The file or an option cannot be used.
    """
    gains = controller(options)
    read = read_loop(options)
    recording = read.recording
    require_length(recording)
    require_direction(recording, gains)
    with user_input(recording.source), busy(f"diagnosing {recording.source}"):
        found = _found(recording, gains, options)
    if options.plot is not None:
        write_whole(options.plot, _picture(found, options))
    tell_assumed(read.assumed, options)
    if options.as_json:
        sys.stdout.write(
            json.dumps({**document(found), "assumed": [a.what for a in read.assumed]}, indent=2, allow_nan=False) + "\n"
        )
    else:
        sys.stdout.write("\n".join(described(found)) + "\n")
    return 1 if found.result.diagnosis.cause == Cause.UNKNOWN else 0


def _found(recording: Recording, given: PidGains | None, options: RecordOptions) -> DiagnosedRecord:
    """The diagnosis with all that belongs to it."""
    window = recording.window()
    read_off = None
    if given is None and not options.open_loop:
        read_off = settings_in_force(window, options.co_min, options.co_max)
    gains = given or (read_off.gains if read_off is not None else None)
    result = api.diagnose_record(window, gains=gains, co_min=options.co_min, co_max=options.co_max)
    seen = screen(window, gains, options.co_min, options.co_max)
    evidence = {**seen.evidence, **result.diagnosis.evidence}
    notes = shortcomings(window, seen, _model(result))
    return DiagnosedRecord(recording.source, window, result, gains, read_off, seen, evidence, notes)


def _model(result: RecordDiagnosis) -> ProcessModel | None:
    """The process, where it is known well enough to say so."""
    estimate = result.estimate
    return estimate.log.model() if estimate is not None and estimate.identifiable else None


def document(found: DiagnosedRecord) -> dict[str, object]:
    """Keys cause, confidence, retune, evidence, gains, form, margins, aim, rival, reason, gains_in_force, model, ..."""
    result = found.result
    settings = result.settings.to_dict() if result.settings is not None and result.diagnosis.retune else {}
    estimate = result.estimate.to_dict() if result.estimate is not None else {}
    told = result.to_dict()
    return {
        **told,
        "evidence": {**found.seen.evidence, **_mapping(told["evidence"])},
        "gains": settings.get("gains"),
        "form": settings.get("form"),
        "margins": settings.get("margins"),
        "gains_in_force": _in_force(found),
        "identifiable": estimate.get("identifiable", False),
        "model": estimate.get("model"),
        "std": estimate.get("std"),
        "notes": list(found.notes),
        "by_eye": _by_eye(found),
    }


def _mapping(value: object) -> dict[str, object]:
    """The evidence of a diagnosis as plain JSON values."""
    assert isinstance(value, dict)
    return value


def _in_force(found: DiagnosedRecord) -> dict[str, object] | None:
    """The settings in force and where they come from."""
    if found.read_off is not None:
        return {"source": "record", **found.read_off.to_dict()}
    if found.gains is None:
        return None
    return {"source": "given", "parallel": {"kp": found.gains.kp, "ki": found.gains.ki, "kd": found.gains.kd}}


def described(found: DiagnosedRecord) -> list[str]:
    """The finding in lines."""
    told = found.result.diagnosis
    lines = [f"{str(told.cause).replace('_', ' ').upper()} (confidence {told.confidence:.0%}): {told.reason}"]
    lines += [f"  note: {note}" for note in found.notes if note != told.reason]
    lines += [f"  {line}" for line in _controller_lines(found)]
    lines += [f"  {line}" for line in _process_lines(found)]
    if told.retune and found.result.settings is not None:
        aim = found.result.aim
        title = "recommended settings:" if aim is None else "recommended first step:"
        lines += [title, *tuning_lines(found.result.settings, chosen_units())]
        if aim is not None:
            lines += ["final settings, once the next record confirms:", *tuning_lines(aim, chosen_units())]
    elif not told.retune:
        lines.append("no change of settings recommended")
    lines += [f"hint: {line}" for line in _by_eye(found)]
    return [*lines, "evidence", *evidence_lines(found.evidence)]


def _by_eye(found: DiagnosedRecord) -> list[str]:
    """What the visual rules say of the trend."""
    model, cause, lines = _model(found.result), found.result.diagnosis.cause, []
    period_s = found.evidence.get("period_s", 0.0)
    if period_s > 0 and found.evidence.get("regularity", 0.0) > REGULAR:
        integrating = model is not None and model.linear().integrators > 0
        may_be_tuning = cause in {*TUNING_CAUSES, Cause.UNKNOWN}
        lines += oscillation_by_eye(period_s, found.gains, integrating=integrating, tuning=may_be_tuning)
    if model is not None and model.tau1_s:
        lines += sampling_by_eye(model.tau1_s, found.window.sample_time_s)
    return lines


def _controller_lines(found: DiagnosedRecord) -> list[str]:
    """The settings in force in a line."""
    if found.gains is None:
        return [f"active settings: not known; {found.read_off.reason}"] if found.read_off is not None else []
    line = f"active settings: {settings_text(found.gains)}"
    if found.read_off is not None:
        line += f", identified from the record ({found.read_off.reason})"
    return [line]


def _process_lines(found: DiagnosedRecord) -> list[str]:
    """The process in a line."""
    model = _model(found.result)
    if model is None or found.result.estimate is None:
        return []
    std = found.result.estimate.log.std()
    values = {"k": model.k, "tau1": model.tau1_s, "tau2": model.tau2_s, "tau3": model.tau3_s, "theta": model.theta_s}
    numbers = (
        f"{name} {values[name]:.4g} +- {std[name]:.2g}{' s' if name != 'k' else ''}" for name in values if name in std
    )
    return [f"process: {model.type}, " + ", ".join(numbers)]


SHOWN = {"linear": "the loop alone", "external": "with an external oscillation", "stuck": "with a sticking valve"}
"""Explanations in words."""
WINNER = {Cause.STICTION: "stuck", Cause.EXTERNAL: "external"}
"""The explanation that is believed, besides the loop by itself."""


def _picture(found: DiagnosedRecord, options: RecordOptions) -> bytes:
    """The record with what was found."""
    from retuner.report.loop_plots import change_of
    from retuner.report.record_plots import ExplainedCurve, RecordPicture, record_png

    told, estimate = found.result.diagnosis, found.result.estimate
    lines = [*_controller_lines(found), *_process_lines(found), *evidence_lines(found.evidence, readings=False)]
    names = [name for name in ("linear", WINNER.get(told.cause, "")) if name in found.result.fits]
    curves = [ExplainedCurve.of(SHOWN[name], found.window, found.result.fits[name]) for name in names]
    title = f"{Path(found.source).name}: {str(told.cause).replace('_', ' ')} ({told.confidence:.0%})"
    picture = RecordPicture(
        found.window,
        title,
        told.reason,
        lines,
        curves,
        limits=(options.co_min, options.co_max),
        loads_s=estimate.load_times_s if estimate is not None else (),
        noise_std=noise_sigma(found.window.pv),
        closed_loop=not options.open_loop,
        change=None if options.open_loop else change_of(found.window, found.result),
    )
    return record_png(picture)
