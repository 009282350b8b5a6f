"""A recommended change of settings, tried on the record that it comes from: what the loop would have done with it."""

import math

import numpy as np

from retuner.adaptive.choice.foreseen import Foreseen, weighed_models
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.replayed import MOST_MODELS, spread
from retuner.adaptive.loop.simulate import step_response
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import Window
from retuner.decision_page.row_values import brief
from retuner.diagnosing import RecordDiagnosis
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

SETTLED = 12.0  # length of a step response in dead times, at the least
WITHIN = 0.05  # A step response has settled where it stays this near to its end, as a share of the step
LONGER, SURE = (1.0, 4.0, 16.0), 0.9
"""A step response is looked at for so many times the usual length, and has settled where it did in this share of it."""


@dataclass(frozen=True, slots=True)
class ShownChange:
    """A change of settings as it is shown.

    window : the record. foreseen : what the change would have made of it, None where nothing can be said of that.
    processes : of the band, the best first. seen : the best as the controller sees it, with its hold. active,
    recommended : the settings; active is None where they are not known. co_limits : lowest and highest co as given.
    """

    window: Window
    foreseen: Foreseen | None
    processes: tuple[LinearProcess, ...]
    seen: LinearProcess
    active: PidGains | None
    recommended: PidGains
    co_limits: tuple[float | None, float | None]


def change_words(foreseen: Foreseen | None) -> str:
    """What the replay says."""
    if foreseen is None:
        return "on the likeliest model the new settings would not hold the loop"
    best, low, high = (100.0 * share for share in foreseen.left)
    band = f" ({low:.0f} to {high:.0f} %)" if high - low > 1.0 else ""
    return f"mean error {best:.0f} %{band} of before, co travel {100.0 * (1.0 - foreseen.calmer):.0f} %"


def step_words(change: ShownChange) -> str:
    """What the change does to a setpoint step and to Ms, on the best model."""
    figures: list[tuple[str, str, str]] = []  # overshoot, settling time and Ms in words, by set
    until_s = settling_s(change.seen, change.recommended)
    for gains in (change.active, change.recommended):
        if gains is None:
            continue
        peak = sensitivity_peak(change.seen, gains)
        if math.isinf(peak):
            figures.append(("without end", "never", "unstable"))
            continue
        filter_s = gains.kd / gains.kp / 10.0 if gains.kp else 0.0
        settling, over = f"over {brief(LONGER[-1] * until_s)} s", 0.0
        for times in LONGER:
            found = step_response(change.seen, gains, times * until_s, filter_s)
            over = max(over, float(np.max(found.pv)) - 1.0)
            away = np.flatnonzero(np.abs(found.pv - 1.0) > WITHIN)
            if not len(away) or found.t[away[-1]] < SURE * times * until_s:
                settling = f"{brief(float(found.t[away[-1]]) if len(away) else 0.0)} s"
                break
        figures.append((f"{100.0 * over:.0f} %", settling, f"{peak:.2f}"))
    titles = ("overshoot", "settles in", "Ms")
    each = zip(*figures, strict=True)
    return ", ".join(f"{title} {' -> '.join(texts)}" for title, texts in zip(titles, each, strict=True))


def settling_s(process: LinearProcess, gains: PidGains) -> float:
    """How long a step response is looked at: until these settings have settled."""
    reset_s = gains.kp / gains.ki if gains.ki and gains.kp else sum(process.lags_s)
    return max(4.0 * abs(reset_s), SETTLED * process.theta_s, 1e-6) + 4.0 * process.theta_s


def change_of(window: Window, result: RecordDiagnosis) -> ShownChange | None:
    """The change that a diagnosis recommends, tried on its record; None where it recommends none."""
    if result.recommended is None:
        return None
    processes, best = processes_of(result), result.model or (result.estimate.log.model() if result.estimate else None)
    if best is None or not processes:
        return None
    seen = best.seen_by_controller(window.sample_time_s).linear()
    shown = spread(processes, MOST_MODELS)
    return ShownChange(window, result.foreseen, shown, seen, result.active, result.recommended, result.co_limits)


def processes_of(result: RecordDiagnosis) -> tuple[LinearProcess, ...]:
    """The processes that a diagnosis leaves possible, the best first; none where it knows none."""
    models = result.likely or tuple(model for model, _ in weighed_models(result.estimate))
    return tuple(dict.fromkeys(model.linear() for model in models))
