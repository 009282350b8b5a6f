"""Settings by what they are worth over all processes that the records allow.

    worth(set) = E[cost(active)] - E[cost(set)],     cost as in likely_processes.py

The expectation is over the processes of the grid with their odds. A set is given if it is worth having on the whole and
makes a bad loop of next to no likely process; the fewer tenths of the odds have a bad loop, the earlier it comes.

Candidates are SIMC's settings (Skogestad 2003) at several tau_c, and the set in force with less or more of all its
actions, which keeps a derivative. SIMC's gain is that of one of the likeliest processes. The integral time at that
gain, min(tau1, 4 / (k' Kc)), is the middle of the odds: of each process's own the shortest would win, and a level would
swing slowly. No candidate has more than MOST_AT_ONCE times the gain and integral action in force: one record shows a
process a few times, and the next record confirms. Nor has one a shorter integral time: a load that enters behind the
process looks like a process with next to no lag (of 6 good loops under a random walk 2 had got three times the integral
action, Ms 2.7 and 4.9).
"""

import math
from collections.abc import Callable, Iterator

import numpy as np

from retuner.adaptive.explanations.likely_processes import (
    LikelyProcesses,
    WorthSettings,
    expected_cost,
    harmless,
    process_model,
    quantile,
)
from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, gain_unit, responses_of, shapes
from retuner.adaptive.explanations.tuning_odds import TuningOdds
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import TAU_I_FACTOR, without_second_lag
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

MIDDLE = 0.5  # the quantile of the odds
TAU_CS = (1.0, 1.5, 2.5, 4.0)  # tau_c of the candidates, in effective dead times
SCALES = (0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8, 1.25, 1.6, 2.0, 2.5, 3.0)
"""Factors on all actions of the set in force."""
TOLD_SHARE, TOLD_MOST = 0.9, 20  # share of the odds whose processes are told with settings, and how many at the most
LEAST_ROOM, MOST_ROOM, ROOMS = 0.1, 10.0, 41  # factors on the set in force that are tried for how far it may be changed


@dataclass(frozen=True, slots=True)
class Worthwhile:
    """Settings worth having.

    models : the likeliest processes, which have most of the odds, the likeliest first.
    sure, likely : times all actions in force that keep Ms good on next to every process, and on half of the odds.
    """

    tuning: Tuning
    models: tuple[ProcessModel, ...]
    sure: float
    likely: float


def likely_processes(odds: TuningOdds, most: int) -> LikelyProcesses:
    """No more than so many processes that stand for all, the likeliest first.

    They are drawn at even steps of the odds (systematic sampling, Madow & Madow 1944) along Ms with the gains in force,
    so that loops near their limits are among them as often as they are likely.
    """
    flat = odds.weights.ravel()
    kept = np.flatnonzero(flat > NEXT_TO_NONE * float(flat.max()))
    kept = kept[np.argsort(odds.robustness.ms.ravel()[kept], kind="stable")]
    drawn = np.searchsorted(np.cumsum(flat[kept]), (np.arange(most) + 0.5) / most * float(flat[kept].sum()))
    times = np.bincount(kept[np.minimum(drawn, len(kept) - 1)])
    chosen, counts = np.flatnonzero(times), times[times > 0]
    order = np.lexsort((-flat[chosen], -counts))
    chosen, counts = chosen[order], counts[order]
    rows, dead, gain = np.unravel_index(chosen, odds.weights.shape)
    loop_gain = GAINS[gain] * odds.robustness.scale / gain_unit(odds.gains, odds.sample_time_s)
    index = tuple(zip(rows.tolist(), dead.tolist(), gain.tolist(), strict=True))
    responses = responses_of(rows, dead) * loop_gain[:, None]
    return LikelyProcesses(index, counts / float(most), responses, odds.sample_time_s)


NEXT_TO_NONE = 1e-9  # share of the likeliest process's odds below which a process never counts


def models(odds: TuningOdds, likely: LikelyProcesses) -> list[ProcessModel]:
    """The likely processes as models, the likeliest first."""
    every, unit = shapes(), gain_unit(odds.gains, odds.sample_time_s) / odds.robustness.scale
    return [
        process_model(
            every[i], DEAD_TIMES[j], GAINS[k] * every[i].unit / unit, odds.gains.direction, odds.sample_time_s
        )
        for i, j, k in likely.index
    ]


def worthwhile(odds: TuningOdds, settings: WorthSettings, asked: Callable[[PidGains], bool]) -> Worthwhile | None:
    """The settings that are worth most over the odds; None where none is worth a change.

    asked : whether the odds of the causes ask for such gains.
    """
    likely = likely_processes(odds, settings.processes)
    known = models(odds, likely)
    before, now = expected_cost(likely, odds.gains, settings)
    found: list[tuple[float, float, Tuning]] = []
    for tuning in _candidates(odds.gains, known, likely.weights, odds.sample_time_s, settings):
        if not asked(tuning.gains):
            continue
        cost, peaks = expected_cost(likely, tuning.gains, settings)
        bad = math.ceil(float(likely.weights @ (peaks > settings.ms_bad)) / settings.bad_share)
        calmed = np.where(peaks < now, 1.0, peaks)  # a loop far too tight is calmed, though it stays too tight
        if before - cost >= settings.worth and harmless(likely.weights, now, calmed, settings):
            found.append((-max(bad, 1), before - cost, tuning))
    best = max(found, key=lambda one: one[:2], default=None)
    return None if best is None else Worthwhile(best[2], _told(known, likely), *_room(odds, likely, settings))


def _told(known: list[ProcessModel], likely: LikelyProcesses) -> tuple[ProcessModel, ...]:
    """The processes that have most of the odds."""
    count = int(np.searchsorted(np.cumsum(likely.weights), TOLD_SHARE)) + 1
    return tuple(known[: min(count, TOLD_MOST)])


def _room(odds: TuningOdds, likely: LikelyProcesses, settings: WorthSettings) -> tuple[float, float]:
    """Factors on all actions in force up to which Ms stays good: on next to every process, and on half of the odds."""
    now, found = odds.gains, [LEAST_ROOM, LEAST_ROOM]
    for scale in np.geomspace(LEAST_ROOM, MOST_ROOM, ROOMS).tolist():
        peaks = likely.peaks(PidGains(now.kp * scale, now.ki * scale, now.kd * scale))
        bad = float(likely.weights @ (peaks > settings.ms_bad))
        for i, share in enumerate((settings.unstable_share, 0.5)):
            found[i] = scale if bad <= share else found[i]
    return found[0], found[1]


def _candidates(
    active: PidGains, known: list[ProcessModel], weights: FloatArray, sample_time_s: float, settings: WorthSettings
) -> Iterator[Tuning]:
    """Settings to be weighed; none beyond what a record carries at once. weights : of the known processes, sum 1."""
    most = settings.most_at_once
    plain = [without_second_lag(model.seen_by_controller(sample_time_s)) for model in known]
    lags, slopes = np.array([(m.tau1_s or math.inf, m.slope) for m in plain]).T
    for model in plain[: settings.rules]:
        for ratio in TAU_CS:
            kc = 1.0 / (model.slope * (1.0 + ratio) * model.theta_s)
            if active.kp and abs(kc) > most * abs(active.kp):
                kc = most * active.kp
            tau_i = quantile(np.minimum(lags, TAU_I_FACTOR / (slopes * kc)), weights, MIDDLE)
            shortest = max(abs(active.kp), abs(kc) / most) / abs(active.ki) if active.ki else math.inf  # see the head
            ki = kc / max(tau_i, shortest)
            if abs(kc) >= settings.least_at_once * abs(active.kp):
                yield Tuning("simc", "series", PidGains(kc, ki), 1.0 / (model.slope * kc) - model.theta_s)
    for scale in SCALES:
        if scale <= most:
            yield Tuning("simc", "series", PidGains(active.kp * scale, active.ki * scale, active.kd * scale))
