"""How results show themselves: print(result) gives the lines of the command, a notebook shows the picture as well."""

import base64
from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch
from html import escape

from matplotlib.figure import Figure

from retuner.adaptive.identification.fitted_curve import fitted_pv
from retuner.adaptive.loop.performance import performance
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decision import Decision
from retuner.api import Identification
from retuner.commands.recorded.diagnose import SHOWN as NAMED
from retuner.commands.recorded.diagnose import WINNER
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


@singledispatch
def text(result: object) -> str:
    """A result in words. Raises TypeError: it is no result of ours."""
    raise TypeError(f"{type(result).__name__} is no result that can be shown")


@singledispatch
def html(result: object) -> str:
    """A result as a part of an HTML page: its words, and its picture where there is one; errors as `text`."""
    raise TypeError(f"{type(result).__name__} is no result that can be shown")


@singledispatch
def figure(result: object) -> Figure:
    """The picture of a result, as matplotlib's figure.

    Raises TypeError: it is no result with a picture.
    Raises ValueError: there is nothing to draw: the record was not kept, or no sample was taken.
    """
    raise TypeError(f"{type(result).__name__} is no result that has a picture")


@text.register
def _(result: TuneResult) -> str:
    return "\n".join(tuning_lines(result, chosen_units()))


@text.register
def _(result: Identification) -> str:
    return "\n".join(described(result))


@text.register
def _(result: RecordDiagnosis) -> str:
    return "\n".join([_cause(result), *_cure(result)])


@text.register
def _(result: Decision) -> str:
    return one_line(result)


@text.register
def _(result: ScheduleDesign) -> str:
    return "\n".join(schedule_lines(result))


@html.register
def _(result: ScheduleDesign) -> str:
    return _shown(result, schedule_figure(result, result.records))


@html.register
def _(result: TuneResult) -> str:
    if result.model is None or result.margins is None or not result.margins.stable:
        return _shown(result)
    row = RuleRow(result, performance(result.model.linear(), result.tuning.gains), None)
    return _shown(result, responses_figure(result.model, (row,)))


@figure.register
def _(result: Identification) -> Figure:
    window, estimate = _kept(result.record), result.estimate
    title = "identified" if estimate.identifiable else "not identifiable"
    curve = ExplainedCurve.of("model", window, fitted_pv(window, estimate))
    return record_figure(
        _picture(window, title, estimate.reason, described(result)[1:], [curve], estimate.load_times_s)
    )


@figure.register
def _(result: RecordDiagnosis) -> Figure:
    window, told = _kept(result.record), result.diagnosis
    names = [name for name in ("linear", WINNER.get(told.cause, "")) if name in result.fits]
    curves = [ExplainedCurve.of(NAMED[name], window, result.fits[name]) for name in names]
    loads_s = result.estimate.load_times_s if result.estimate is not None else ()
    picture = _picture(window, _cause(result, reason=False), told.reason, _cure(result), curves, loads_s)
    return record_figure(replace(picture, change=change_of(window, result)))


@html.register(Identification)
@html.register(RecordDiagnosis)
def _(result: Identification | RecordDiagnosis) -> str:
    return _shown(result, None if result.record is None else figure(result))


@text.register(LoopTrend)
@text.register(PidController)
def _(result: LoopTrend | PidController) -> str:
    return repr(result)


@figure.register
def _(result: LoopTrend) -> Figure:
    return trend_figure(result)


@figure.register
def _(result: PidController) -> Figure:
    return trend_figure(result.trend)


@html.register(LoopTrend)
@html.register(PidController)
def _(result: LoopTrend | PidController) -> str:
    trend = result.trend if isinstance(result, PidController) else result
    return _shown(result, trend_figure(trend) if len(trend.t_s) else None)


def _kept(record: Window | None) -> Window:
    if record is None:
        raise ValueError("this result has no record to draw: it was not made by retuner.diagnose or retuner.identify")
    return record


@text.register
def _(result: LoopRecord) -> str:
    return repr(result)


@html.register
def _(result: LoopRecord) -> str:
    window = result.recording.window()
    assumed = [one.what for one in result.assumed]
    picture = _picture(window, result.tag or "record", result.recording.source, assumed, (), ())
    return _shown(result, record_figure(picture))


@html.register
def _(result: Decision) -> str:
    return article(DecisionView(document_of(result), None, "", 0.0))


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


def _shown(result: object, picture: Figure | None = None) -> str:
    words = f"<pre>{escape(text(result))}</pre>"
    if picture is None:
        return words
    data = base64.b64encode(drawn(picture, "picture of the result", ".svg")).decode()
    return f'{words}<img style="max-width:100%" src="data:image/svg+xml;base64,{data}">'
