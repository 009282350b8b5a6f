"""How results show themselves: print(result) gives the lines of the command, a notebook shows the picture as well."""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Any, TypeVar

from matplotlib.figure import Figure

from retuner.adaptive.identification.fitted_curve import fitted_pv
from retuner.adaptive.loop.performance import performance
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decision import Decision
from retuner.api import Identification
from retuner.commands.recorded.diagnose import explained_curves
from retuner.commands.recorded.identify import described
from retuner.commands.recorded.schedule import described as schedule_lines
from retuner.decision_page.decision_document import article
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.decision_words import document_of, one_line
from retuner.decision_page.shown_units import chosen_units
from retuner.decision_page.svg import drawn
from retuner.diagnosing import RecordDiagnosis
from retuner.drivers.historian.loop_record import LoopRecord
from retuner.pid_controller import PidController
from retuner.report.change_of_settings import change_of
from retuner.report.loop_plots import trend_figure
from retuner.report.record_plots import ExplainedCurve, RecordPicture, record_figure
from retuner.report.rule_comparison import RuleRow
from retuner.report.tuning_plots import responses_figure
from retuner.schedule_report.schedule_page import schedule_figure
from retuner.scheduling import ScheduleDesign
from retuner.simulation.loop_trend import LoopTrend
from retuner.tuning import TuneResult, tuning_lines


def text(result: object) -> str:
    """A result in words. Raises TypeError: it is no result of ours."""
    return _told_by(TEXTS, result, "no result that can be shown")


def html(result: object) -> str:
    """A result as a part of an HTML page: its words, and its picture where there is one; errors as `text`."""
    return _told_by(PAGES, result, "no result that can be shown")


def figure(result: object) -> Figure:
    """The picture of a result, as matplotlib's figure.

    Raises TypeError: it is no result with a picture.
    Raises ValueError: there is nothing to draw: the record was not kept, or no sample was taken.
    """
    return _told_by(FIGURES, result, "no result that has a picture")


Told = TypeVar("Told")


def _told_by(how: Mapping[type, Callable[[Any], Told]], result: object, otherwise: str) -> Told:
    tell = next((how[kind] for kind in type(result).__mro__ if kind in how), None)
    if tell is None:
        raise TypeError(f"{type(result).__name__} is {otherwise}")
    return tell(result)


def _cause(result: RecordDiagnosis, *, reason: bool = True) -> str:
    told = result.diagnosis
    cause = f"{str(told.cause).replace('_', ' ').upper()} (confidence {told.confidence:.0%})"
    return f"{cause}: {told.reason}" if reason else cause


def _cure(result: RecordDiagnosis) -> list[str]:
    if not result.diagnosis.retune or result.settings is None:
        return ["no change of settings recommended"]
    title = "recommended settings:" if result.aim is None else "recommended first step:"
    return [title, *tuning_lines(result.settings, chosen_units())]


def _picture(
    window: Window,
    title: str,
    subtitle: str,
    lines: Sequence[str],
    curves: Sequence[ExplainedCurve],
    loads_s: Sequence[float],
) -> RecordPicture:
    closed = bool((window.sp != window.pv).any())
    return RecordPicture(
        window, title, subtitle, lines, curves, loads_s, noise_std=noise_sigma(window.pv), closed_loop=closed
    )


def _kept(record: Window | None) -> Window:
    if record is None:
        raise ValueError("this result has no record to draw: it was not made by retuner.diagnose or retuner.identify")
    return record


def _of_identification(result: Identification) -> Figure:
    window, estimate = _kept(result.record), result.estimate
    title = "identified" if estimate.identifiable else "not identifiable"
    curve = ExplainedCurve.of("model", window, fitted_pv(window, estimate))
    return record_figure(
        _picture(window, title, estimate.reason, described(result)[1:], [curve], estimate.load_times_s)
    )


def _of_diagnosis(result: RecordDiagnosis) -> Figure:
    window, told = _kept(result.record), result.diagnosis
    loads_s = result.estimate.load_times_s if result.estimate is not None else ()
    title, curves = _cause(result, reason=False), explained_curves(window, result)
    picture = _picture(window, title, told.reason, _cure(result), curves, loads_s)
    return record_figure(replace(picture, change=change_of(window, result)))


def _of_record(result: LoopRecord) -> Figure:
    window, assumed = result.recording.window(), [one.what for one in result.assumed]
    return record_figure(_picture(window, result.tag or "record", result.recording.source, assumed, (), ()))


def _of_tuning(result: TuneResult) -> Figure | None:
    if result.model is None or result.margins is None or not result.margins.stable:
        return None
    row = RuleRow(result, performance(result.model.linear(), result.tuning.gains), None)
    return responses_figure(result.model, (row,))


def _with(picture: Callable[[Any], Figure | None]) -> Callable[[Any], str]:
    def shown(result: object) -> str:
        words, drawing = f"<pre>{escape(text(result))}</pre>", picture(result)
        if drawing is None:
            return words
        data = base64.b64encode(drawn(drawing, "picture of the result", ".svg")).decode()
        return f'{words}<img style="max-width:100%" src="data:image/svg+xml;base64,{data}">'

    return shown


TEXTS: dict[type, Callable[[Any], str]] = {
    TuneResult: lambda result: "\n".join(tuning_lines(result, chosen_units())),
    Identification: lambda result: "\n".join(described(result)),
    RecordDiagnosis: lambda result: "\n".join([_cause(result), *_cure(result)]),
    ScheduleDesign: lambda result: "\n".join(schedule_lines(result)),
    Decision: one_line,
    LoopRecord: repr,
    LoopTrend: repr,
    PidController: repr,
}
FIGURES: dict[type, Callable[[Any], Figure]] = {
    Identification: _of_identification,
    RecordDiagnosis: _of_diagnosis,
    LoopTrend: trend_figure,
    PidController: lambda result: trend_figure(result.trend),
}
PAGES: dict[type, Callable[[Any], str]] = {
    TuneResult: _with(_of_tuning),
    Identification: _with(lambda result: None if result.record is None else figure(result)),
    RecordDiagnosis: _with(lambda result: None if result.record is None else figure(result)),
    ScheduleDesign: _with(lambda result: schedule_figure(result, result.records)),
    Decision: lambda result: article(DecisionView(document_of(result), None, "", 0.0)),
    LoopRecord: _with(_of_record),
    LoopTrend: _with(lambda result: trend_figure(result) if len(result.t_s) else None),
    PidController: _with(lambda result: trend_figure(result.trend) if len(result.trend.t_s) else None),
}
"""How each kind of result shows itself."""
