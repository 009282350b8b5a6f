"""How results show themselves: print(result) gives the lines of the command, a notebook shows the picture as well."""

import base64
from collections.abc import Sequence
from functools import singledispatch

from retuner.adaptive.identification.fitted_curve import fitted_pv
from retuner.adaptive.loop.performance import performance
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decision import Decision
from retuner.api import Identification, RecordDiagnosis
from retuner.commands.recorded.diagnose import SHOWN as NAMED
from retuner.commands.recorded.diagnose import WINNER
from retuner.commands.recorded.identify import described
from retuner.commands.recorded.schedule import described as schedule_lines
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.explain import document_of, one_line
from retuner.decision_page.html import escaped
from retuner.decision_page.page import article
from retuner.decision_page.shown_units import chosen_units
from retuner.drivers.historian.loop_record import LoopRecord
from retuner.report.record_plots import ExplainedCurve, RecordPicture, record_png
from retuner.report.rule_comparison import RuleRow
from retuner.report.tuning_plots import responses_png
from retuner.schedule_report.drawing import schedule_png
from retuner.scheduling import ScheduleDesign
from retuner.tuning import TuneResult, tuning_lines


@singledispatch
def text(result: object) -> str:
    """A result in words.

    Raises
    ------
    TypeError
        It is no result of ours.
    """
    raise TypeError(f"{type(result).__name__} is no result that can be shown")


@singledispatch
def html(result: object) -> str:
    """A result as a part of an HTML page: its words, and its picture where there is one; errors as `text`."""
    raise TypeError(f"{type(result).__name__} is no result that can be shown")


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
    return _shown(result, schedule_png(result, result.records))


@html.register
def _(result: TuneResult) -> str:
    if result.model is None or result.margins is None or not result.margins.stable:
        return _shown(result, b"")
    row = RuleRow(result, performance(result.model.linear(), result.tuning.gains), None)
    return _shown(result, responses_png(result.model, (row,)))


@html.register
def _(result: Identification) -> str:
    window, estimate = result.record, result.estimate
    if window is None:
        return _shown(result, b"")
    title = "identified" if estimate.identifiable else "not identifiable"
    curve = ExplainedCurve.of("model", window, fitted_pv(window, estimate))
    picture = _picture(window, title, estimate.reason, described(result)[1:], [curve], estimate.load_times_s)
    return _shown(result, picture)


@html.register
def _(result: RecordDiagnosis) -> str:
    window, told = result.record, result.diagnosis
    if window is None:
        return _shown(result, b"")
    names = [name for name in ("linear", WINNER.get(told.cause, "")) if name in result.fits]
    curves = [ExplainedCurve.of(NAMED[name], window, result.fits[name]) for name in names]
    loads_s = result.estimate.load_times_s if result.estimate is not None else ()
    return _shown(result, _picture(window, _cause(result, reason=False), told.reason, _cure(result), curves, loads_s))


@text.register
def _(result: LoopRecord) -> str:
    return repr(result)


@html.register
def _(result: LoopRecord) -> str:
    window = result.recording.window()
    assumed = [one.what for one in result.assumed]
    return _shown(result, _picture(window, result.tag or "record", result.recording.source, assumed, (), ()))


@html.register
def _(result: Decision) -> str:
    return article(DecisionView(document_of(result), None, "", 0.0))


def _cause(result: RecordDiagnosis, *, reason: bool = True) -> str:
    """The cause, and why."""
    told = result.diagnosis
    cause = f"{str(told.cause).replace('_', ' ').upper()} (confidence {told.confidence:.0%})"
    return f"{cause}: {told.reason}" if reason else cause


def _cure(result: RecordDiagnosis) -> list[str]:
    """The settings that follow, if any do."""
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
) -> bytes:
    """The record with what was found."""
    closed = bool((window.sp != window.pv).any())
    return record_png(
        RecordPicture(
            window, title, subtitle, lines, curves, loads_s, noise_std=noise_sigma(window.pv), closed_loop=closed
        )
    )


def _shown(result: object, png: bytes) -> str:
    """Words, and the picture below them."""
    words = f"<pre>{escaped(text(result))}</pre>"
    if not png:
        return words
    return f'{words}<img style="max-width:100%" src="data:image/png;base64,{base64.b64encode(png).decode()}">'
