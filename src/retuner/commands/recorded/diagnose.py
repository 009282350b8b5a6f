"""retuner diagnose: what is behind a loop's behaviour, with the evidence, and the settings that would cure it.

Where the settings in force are not given they are read off the record (adaptive/controller_settings/read_off.py):
without them nothing can be said of the tuning.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from retuner import diagnosing
from retuner.adaptive.audit.loop_screen import LoopScreen, screen_loop
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.controller_settings.read_off import SettingsInForce, settings_in_force
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.adaptive.diagnosis.enough_data import shortcomings
from retuner.adaptive.explanations.proposed_test import DecidingTest, TestKind
from retuner.adaptive.indexes.days import days_of
from retuner.adaptive.indexes.screening import Screening, screen
from retuner.adaptive.rules.visual import oscillation_by_eye, sampling_by_eye
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window
from retuner.commands.options import RecordOptions, tell
from retuner.commands.recorded.recorded_loop import (
    controller,
    days_told,
    read_records_of_loop,
    require_fitting,
    require_length,
    tell_assumed,
)
from retuner.commands.signatures import DiagnoseOptions
from retuner.decision_page.decision_words import settings_text
from retuner.decision_page.evidence_words import REGULAR, evidence_lines
from retuner.decision_page.row_values import brief, in_full
from retuner.decision_page.shown_units import chosen_units
from retuner.diagnosing import RecordDiagnosis
from retuner.errors import UserError, user_input
from retuner.files import write_whole
from retuner.report.change_of_settings import ShownChange, change_of, change_words, step_words
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.tuning import tune, tuning_lines
from retuner.verbosity import busy

if TYPE_CHECKING:  # slow to load, for pictures only
    from retuner.report.record_plots import ExplainedCurve


@dataclass(frozen=True, slots=True)
class DiagnosedRecord:
    """A diagnosed record with everything that is shown.

    source : of all records. window : of the one that the verdict is told of. gains : the settings in force, given or
    read off. read_off : how they were, None when they were given. before : those that ran before it, in words. seen,
    loop : indexes of that record. change : what the recommended settings would have done, None where there are none.
    evidence : numbers by name, of the indexes and of the diagnosis. notes : what the record lacks.
    """

    source: str
    window: Window
    result: RecordDiagnosis
    gains: PidGains | None
    read_off: SettingsInForce | None
    before: tuple[str, ...]
    seen: Screening
    loop: LoopScreen
    change: ShownChange | None
    evidence: dict[str, float]
    notes: tuple[str, ...]


def diagnose(options: DiagnoseOptions) -> int:
    """Diagnose and show; the exit status: 0, or 1 when no cause can be named.

    Raises UserError, RecordingError: the file or an option cannot be used.
    """
    gains = controller(options)
    # Refuse aims that are none, and one without its numbers
    if options.aim not in AIMS:
        raise UserError(f"--aim {options.aim}: give one of {', '.join(AIMS)}")
    given = options.ymax is not None or options.u0 is not None
    if (AIMS[options.aim] is None) == given:
        wanted = "--ymax: how far pv may go" if not given else "no --ymax and no --u0: they go with the other aims"
        raise UserError(f"--aim {options.aim}: give {wanted}")
    records = read_records_of_loop(options)
    for read in records:
        require_length(read.recording)
        require_fitting(read.recording, gains)
    source = records[0].recording.source
    source = source if len(records) == 1 else f"{source} and {len(records) - 1} more"
    with user_input(source), busy(f"diagnosing {source}"):
        whole = [read.recording.window() for read in records]
        windows = diagnosing.parts_of(whole, gains, options.co_min, options.co_max)
        result = diagnosing.diagnose_windows(windows, gains=gains, co_min=options.co_min, co_max=options.co_max)
        window = windows[result.on]
        asked = gains is None and not options.open_loop
        read_off = settings_in_force(window, options.co_min, options.co_max) if asked else None
        seen = screen(window, result.active, options.co_min, options.co_max)
        evidence = {**seen.evidence, **result.diagnosis.evidence}
        model = result.model
        notes, loop = shortcomings(window, seen, model), screen_loop(window, model.theta_s if model else None)
        change = None if options.open_loop else change_of(window, result)
        gains, before = result.active, _before(result, windows, one_record=len(records) == 1)
        found = DiagnosedRecord(source, window, result, gains, read_off, before, seen, loop, change, evidence, notes)
    if options.plot is not None:
        write_whole(options.plot, _picture(found, options))
    assumed = tuple(dict.fromkeys(one for read in records for one in read.assumed))
    assumed += days_told(sum(len(days_of(one)) for one in whole), len(records))
    tell_assumed(assumed, options)
    rule, model = AIMS[options.aim], found.result.model
    if rule is None:
        aims, aimed = [], None
    elif model is None:
        aims, aimed = [f"{options.aim:<{NAME}}none: the record does not tell the process"], None
    else:
        low, high = np.percentile(found.window.co, USUAL).tolist()
        u0 = options.u0 if options.u0 is not None else high - low
        with user_input(f"--aim {options.aim}"):
            settings = tune(model, rule, u0=u0, y_max=options.ymax)
        what = f"for a step of the load by {u0:.3g} of co pv goes {abs(options.ymax or 0.0):.3g} at most"
        note = "".join(f"; {one}" for one in settings.tuning.notes)
        line = f"{options.aim:<{NAME}}{settings_text(settings.gains)}: {what}{note}"
        aims, aimed = [line], {"aim": options.aim, "u0": u0, "ymax": options.ymax, **settings.to_dict()}
    read_as = {"records": len(records), "assumed": [a.what for a in assumed]}
    lines = [*described(found), *(f"  {line}" for line in aims)]
    lines += evidence_of(found) if options.with_evidence else []
    tell({**document(found), "aimed": aimed, **read_as}, lines, as_json=options.as_json)
    return 1 if found.result.diagnosis.cause == Cause.UNKNOWN else 0


def _before(result: RecordDiagnosis, windows: Sequence[Window], *, one_record: bool) -> tuple[str, ...]:
    """The settings that ran before those in force, in words."""
    until = [f" until {one.t_s[-1]:.5g} s" if one_record else " in a record" for one in windows]
    return tuple(f"{settings_text(own)}{end}" for own, end in zip(result.earlier, until, strict=False) if own)


AIMS = {"tight": None, "smooth": "simc-smooth", "averaging": "averaging"}
"""Rules of the aims; tight control is what is recommended anyway."""
USUAL = (5.0, 95.0)  # percentiles of co between which it moves because of loads


def document(found: DiagnosedRecord) -> dict[str, object]:
    """Keys cause, confidence, retune, evidence, gains, form, margins, aim, rival, reason, gains_in_force, model, ..."""
    result, gains = found.result, found.gains
    estimate = result.estimate.to_dict() if result.estimate is not None else {}
    told = result.to_dict()
    value = told["evidence"]
    assert isinstance(value, dict)
    in_force: dict[str, object] | None = None
    if found.read_off is not None:
        in_force = {"source": "record", **found.read_off.to_dict()}
    elif gains is not None:
        in_force = {"source": "given", "parallel": {"kp": gains.kp, "ki": gains.ki, "kd": gains.kd}}
    return {
        **told,
        "evidence": {**found.seen.evidence, **value},
        "gains_in_force": in_force,
        "before": list(found.before),
        "identifiable": estimate.get("identifiable", False),
        "model": estimate.get("model"),
        "std": estimate.get("std"),
        "next": told.get("next"),
        "performance": found.loop.to_dict(),
        "notes": list(found.notes),
        "by_eye": _by_eye(found),
    }


def described(found: DiagnosedRecord) -> list[str]:
    """The finding in some eight lines."""
    result = found.result
    told = result.diagnosis
    title = str(told.cause).replace("_", " ").upper()
    others = [(cause, p) for cause, p in told.causes.items() if cause != told.cause and p >= WORTH_NAMING]
    second = "".join(f", or {cause.replace('_', ' ')} {_odds(p)}" for cause, p in others[:1])
    headline = f"{title} ({_odds(told.confidence)}{second})"
    lines = [f"{headline}: {told.reason}", *_controller_lines(found)]
    if told.retune and result.settings is not None:
        tuning = result.settings.tuning
        title = "first step" if result.aim is not None else "recommended"
        tau_c = "" if tuning.tau_c_s is None else f" (tau_c {tuning.tau_c_s:.4g} s)"
        lines.append(f"{title:<{NAME}}{settings_text(tuning.gains)}{tau_c}")
        at = len(lines) - 1
        if result.aim is not None:
            lines.append(f"{'then':<{NAME}}{settings_text(result.aim.tuning.gains)}, once the next record confirms")
        if result.room is not None and min(result.room) > 1.0:
            sure, likely = result.room
            half = f", {likely:.2g} times on half of them" if likely > sure else ""
            lines[at] += f"; up to {sure:.2g} times the active gain is safe on every likely process{half}"
        if found.change is not None:
            lines.append(f"{'with these':<{NAME}}{change_words(result.foreseen)}; {step_words(found.change)}")
    elif not told.retune:
        lines.append(f"{'recommended':<{NAME}}no change of settings")
    lines += _process_lines(found)
    lines.append(f"{'the loop':<{NAME}}{loop_words(found.loop)}")
    lines += [f"{'note':<{NAME}}{note}" for note in found.notes if note != told.reason]
    lines += [f"{'next':<{NAME}}{line}" for line in _next(found)]
    lines += [f"{'run it':<{NAME}}{command_for(told.next)}"] if told.next is not None and not told.retune else []
    return [lines[0], *(f"  {line}" for line in lines[1:])]


NAME = 13  # width of the names of lines
WORTH_NAMING = 0.1  # probability from which a second cause is named in the headline


def _odds(p: float) -> str:
    return "over 99 %" if p > SUREST else f"{100.0 * p:.0f} %"


SUREST = 0.99  # no probability is told larger


def loop_words(loop: LoopScreen) -> str:
    """What monitoring products tell of a loop, in a line."""
    days = loop.span_s / DAY_S
    mean = loop.iae_per_day / DAY_S
    parts = [f"mean error {brief(mean)}" if loop.setpoint else "no setpoint"]
    parts += [f"Harris index {loop.harris:.2f}"] if loop.setpoint else []
    parts.append("no lasting oscillation" if loop.period_s is None else f"oscillates at {brief(loop.period_s)} s")
    parts.append(f"co travels {brief(loop.effort_per_day * days)} and turns {loop.reversals_per_day * days:,.0f} times")
    parts.append(f"automatic {100.0 * loop.in_automatic:.0f} %, at limits {100.0 * loop.at_limits:.0f} %")
    return ", ".join(parts)


DAY_S = 86_400.0


def _next(found: DiagnosedRecord) -> list[str]:
    told = found.result.diagnosis
    if told.retune:
        return ["set these, then diagnose the next record together with this one"]
    if told.next is not None:
        return [f"{test_words(told.next)}; diagnose its record together with this one"]
    saved = found.result.foreseen
    due = saved is not None and saved.due
    # what tuning could gain says whether the odds between in order and sluggish matter
    open_still = told.cause is Cause.OK and due and told.confidence < OddsSettings().undecided
    nothing = told.cause is Cause.SLUGGISH and saved is not None and not due
    cure = WHAT_TO_DO.get(Cause.SLUGGISH if open_still else Cause.OK if nothing else told.cause)
    return _by_eye(found) or ([cure] if cure is not None else [])


WHAT_TO_DO = {
    Cause.STICTION: "have positioner, packing and linkage of the valve checked; `retuner experiment valve` measures it",
    Cause.EXTERNAL: "find the source: another loop or machine that oscillates at this period",
    Cause.SATURATION: "check the size of the actuator, and the load",
    Cause.NOISE: "filter pv at most",
    Cause.OK: "nothing to do",
    **dict.fromkeys(TUNING_CAUSES, "no test of a usual size is likely to decide: diagnose more records with this one"),
}
"""What a person does about a cause that other gains do not cure."""


def test_words(test: DecidingTest) -> str:
    """A test to make, in words."""
    what = {
        TestKind.SETPOINT: "a setpoint step of {size:.3g}, {hold} out and {hold} back: it decides",
        TestKind.VALVE: "in manual, steps of co of {size:.3g} up, up, down, down, each held {hold}: they decide",
    }[test.kind]
    hold = f"{test.hold_s / 60.0:.0f} min" if test.hold_s >= MINUTES_FROM_S else f"{test.hold_s:.3g} s"
    return f"{what.format(size=test.size, hold=hold)} with {_odds(test.decides)} probability"


MINUTES_FROM_S = 600.0  # times from here on are told in minutes


def command_for(test: DecidingTest) -> str:
    """The command that makes a test. CONFIG : the configuration of the loop's controller."""
    hold = f"{float(f'{test.hold_s:.3g}'):g}"
    if test.kind is TestKind.VALVE:
        return f"retuner experiment valve CONFIG --step {test.size:.3g} --hold {hold} --short"
    return f"retuner experiment setpoint CONFIG --amplitude {test.size:.3g} --hold {hold}"


def evidence_of(found: DiagnosedRecord) -> list[str]:
    """All numbers behind it: odds, settings in every form, indexes."""
    result = found.result
    odds = ", ".join(f"{cause.replace('_', ' ')} {p:.1%}" for cause, p in result.diagnosis.causes.items())
    lines = [f"odds: {odds}"] if odds else []
    lines += [f"hint: {line}" for line in _by_eye(found)]
    if found.read_off is not None and found.read_off.gains is not None:
        lines.append(f"active settings: identified from the record ({found.read_off.reason})")
    for title, settings in (("recommended settings:", result.settings), ("final settings:", result.aim)):
        if settings is not None and result.diagnosis.retune:
            lines += [title, *tuning_lines(settings, chosen_units())]
    return [*lines, "evidence", *evidence_lines(found.evidence)]


def _by_eye(found: DiagnosedRecord) -> list[str]:
    model, cause, lines = found.result.model, found.result.diagnosis.cause, []
    period_s = found.evidence.get("period_s", 0.0)
    if period_s > 0 and found.loop.period_s is not None and found.evidence.get("regularity", 0.0) > REGULAR:
        integrating = model is not None and model.linear().integrators > 0
        may_be_tuning = cause in {*TUNING_CAUSES, Cause.UNKNOWN}
        lines += oscillation_by_eye(period_s, found.gains, integrating=integrating, tuning=may_be_tuning)
    if model is not None and model.tau1_s:
        lines += sampling_by_eye(model.tau1_s, found.window.sample_time_s)
    return lines


def _controller_lines(found: DiagnosedRecord) -> list[str]:
    if found.gains is None:
        why = found.read_off.reason if found.read_off is not None else ""
        why = "" if why == found.result.diagnosis.reason else f": {why}; give them with --kc and --tau-i"
        rough = found.read_off.rough if found.read_off is not None else None
        known = f"about {settings_text(rough)}, too rough for new settings" if rough is not None else "not known"
        return [f"{'active':<{NAME}}{known}{why}"] if found.read_off is not None else []
    shown = ", as the record shows" if found.read_off is not None else ""
    before = [f"{'before':<{NAME}}{', '.join(found.before)}: what ran so shows the process only"]
    return [f"{'active':<{NAME}}{settings_text(found.gains)}{shown}", *before[: len(found.before)]]


def _process_lines(found: DiagnosedRecord) -> list[str]:
    model, estimate = found.result.model, found.result.estimate
    if model is None:
        return []
    known = estimate.log.std() if estimate is not None and not found.result.likely else {}
    std = {name: f" +- {in_full(float(f'{one:.2g}'))}" for name, one in known.items()}
    numbers = [
        f"{name} {in_full(value)}{std.get(name, '')}{' s' if name != 'k' else ''}"
        for name, value in {"k": model.k, **model.times_s, "theta": model.theta_s}.items()
        if value
    ]
    numbers += [f"zeta {model.zeta:.3g}"] if model.zeta < 1 else []
    among = f", the most likely of {len(found.result.likely)}" if len(found.result.likely) > 1 else ""
    return [f"{'process':<{NAME}}{model.type}, {', '.join(numbers)}{among}"]


SHOWN = {"linear": "the loop alone", "external": "with an external oscillation", "stuck": "with a sticking valve"}
"""Explanations in words."""
WINNER = {Cause.STICTION: "stuck", Cause.EXTERNAL: "external"}
"""The explanation that is believed, besides the loop by itself."""


def explained_curves(window: Window, result: RecordDiagnosis) -> "list[ExplainedCurve]":
    """pv of a record as the loop alone explains it, and as the explanation does that is believed."""
    from retuner.report.record_plots import ExplainedCurve

    names = [name for name in ("linear", WINNER.get(result.diagnosis.cause, "")) if name in result.fits]
    return [ExplainedCurve.of(SHOWN[name], window, result.fits[name]) for name in names]


def _picture(found: DiagnosedRecord, options: RecordOptions) -> bytes:
    from retuner.decision_page.svg import drawn
    from retuner.report.record_plots import RecordPicture, record_figure

    told, estimate = found.result.diagnosis, found.result.estimate
    lines = [*_controller_lines(found), *_process_lines(found), *evidence_lines(found.evidence, readings=False)]
    curves = explained_curves(found.window, found.result)
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
        change=found.change,
    )
    assert options.plot is not None
    return drawn(record_figure(picture), title, options.plot.suffix)
