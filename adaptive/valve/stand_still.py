"""A valve that sticks, over another band at every stop: pv stands while co travels, then steps to where co has gone.

One or two slips a record and no cycle: no single band explains it, and likelihood alone does not decide it, because
load steps and ramps explain as much. What decides is stand-still measured inside the plateaus of pv (plateaus.py):

    leg       a run of one-signed error on one plateau, pv not drifting, co moving the way that the integral says
    c         how far co goes in it, as a share of its range; idle = sum of c; dwell = the longest leg in units of tau_I
    slip      pv goes from one plateau to the next; it agrees where co has gone that way since its last turning point

    stands    idle >= 1 on two legs or more, dwell >= 10 tau_I and 5 lags of the slips, and two thirds of the slips, by
              their squares, agree
    sticks    and the slips are faster than the loop could be (its own crossing takes tau_I (1 + 1/(Kc k)) and more), or
              a setpoint step is answered by nothing for 8 tau_I while co travels, and then by a step
    does not answer    one leg over nearly all that co ever moves, 20 tau_I long, and no slip

How far it stands is a number as well, 0 to 1: each of these numbers rises from nothing at half of its bound to all at
the bound, and the least of them counts. (Every second row, or nine tenths of the rows, had made a leg of 21 % of co's
range one of 19 %.) What stands changes no gains. Without the setpoint's or the slip's evidence the answer says that it
may be a load that drifts with co (a triangle in a fast loop).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from retuner.adaptive.indexes.autocovariance import running_mean
from retuner.adaptive.indexes.recording_quality import runs
from retuner.adaptive.signals.sample import Window, median
from retuner.adaptive.valve.plateaus import Plateau, Steps, as_steps, plateaus, price
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

MOST_ROWS = 800  # rows that are looked at; of a longer record means over several samples
SMOOTHED = 100  # the error is smoothed over one part in so many of the record
MOST_TOLD = 4  # stands and slips that are told with their times
FEWEST_ROWS = 10  # rows of a leg
ABOUT = 0.5
"""Share of a stand's length from which plateaus are looked for: on them the error is smoothed a little otherwise."""
STEPS_OF_A_PROCESS = 1
"""A process, with its gain, lags and dead time, costs as much as so many steps beside the one lag of the plateaus."""


@dataclass(frozen=True, slots=True)
class StandStillSettings:
    """Settings, each with its meaning and the range in which it makes sense."""

    leg_error: float = 0.02  # mean error of a leg as a share of pv's range, 0.01 to 0.1
    leg_sigmas: float = 3.0  # and in standard deviations of its mean
    drift: float = 0.15  # how far pv may drift in a leg, share of its range
    travel: float = 0.2  # share of co's range from which a leg counts, 0.1 to 0.4
    idle: float = 1.0  # sum of the legs' travel in co's range from which pv stands, 0.6 to 2
    legs: int = 2  # how many legs that takes
    dwell: float = 10.0  # longest leg in units of tau_I, 3 to 30
    slip_travel: float = 0.1  # co's travel before a slip that agrees, share of its range, 0.05 to 0.3
    remainder: float = 3.0  # what the steps may leave in standard deviations of the noise
    explained: float = 0.93  # or the share of pv's variance that they must explain
    # by how much a linear explanation must be the likelier one (Schwarz's criterion, both at the price of a step for
    # each of their loads) for the plateaus not to count, 25 to 200: load steps bought at setpoint changes explain a
    # stuck valve as well, at up to 77 in favour of the fiction
    likelier: float = 100.0
    # T of the slips in units of tau_I up to which no loop makes them, 0.5 to 1 (a triangle in a fast loop left 0.87)
    quick: float = 0.75
    silent: float = 8.0  # units of tau_I for which a setpoint step is not answered by a stuck valve
    answered: float = 0.3  # share of the step that counts as an answer
    pushed: float = 0.4  # share of its range that co travels meanwhile, the kick left out
    step_sigmas: float = 5.0  # smallest setpoint step, in standard deviations
    sure: float = 0.8  # confidence that slips faster than the loop could be give to stiction
    dead_travel: float = 0.9  # travel of the one leg in which pv does not answer at all
    dead_dwell: float = 20.0  # and its dwell


@dataclass(frozen=True, slots=True)
class Leg:
    """A stretch in which pv stands beside its setpoint and co travels. travel : share of co's range. dwell : tau_I."""

    start_s: float
    end_s: float
    travel: float
    dwell: float


@dataclass(frozen=True, slots=True)
class StandStill:
    """What the plateaus of a record show.

    legs : that count. slips_s, agreed : when pv went to another level, and how many of these times co had gone there.
    ends_s : those of the latter that end a leg.
    stands, sticks, dead : the verdicts. degree : how far it stands, 0 to 1. quick : how far its slips are no loop's.
    rows, sigma, criterion : of the steps; see plateaus.py.
    """

    legs: tuple[Leg, ...]
    slips_s: tuple[float, ...]
    agreed: int
    ends_s: tuple[float, ...]
    stands: bool
    sticks: bool
    dead: bool
    degree: float
    quick: float
    rows: int
    sigma: float
    criterion: float

    def lead_of(self, variance: float, loads: int) -> float:
        """Lead of a linear explanation over the plateaus. variance, loads : what it leaves, and needs."""
        return 2 * (self.criterion - price(variance * self.rows, self.rows, self.sigma, loads + STEPS_OF_A_PROCESS))

    @property
    def idle(self) -> float:
        """Travel of co without an answer, in its range."""
        return sum(leg.travel for leg in self.legs)

    @property
    def dwell(self) -> float:
        """Length of the longest leg, in units of tau_I."""
        return max((leg.dwell for leg in self.legs), default=0.0)


def stand_still(window: Window, gains: PidGains, settings: StandStillSettings) -> StandStill | None:
    """Look for stand-still; None where the controller has no integral action or nothing moves.

    window : the record. gains : in force, for the direction of the controller and its integral time.
    """
    if not gains.ki or np.ptp(window.pv) == 0 or np.ptp(window.co) == 0:
        return None
    rows = _thinned(window)
    tau_i = max(abs(gains.kp / gains.ki), window.sample_time_s) / rows.sample_time_s
    # The error keeps its sign for about as long as a stand takes; else plateaus are looked for in vain
    error = running_mean(rows.sp - rows.pv, max(len(rows.pv) // SMOOTHED, 1))
    longest = max((end - first for sign in (1.0, -1.0) for first, end in runs(sign * error > 0)), default=0)
    if longest < ABOUT * settings.dwell * tau_i:
        return None
    steps = as_steps(rows.pv)
    found = plateaus(rows.pv, steps)
    legs = [leg for p in found for leg in _legs(rows, p, steps, gains, tau_i, settings)]
    counted = tuple(sorted((leg for leg in legs if leg.travel > settings.travel), key=lambda leg: leg.start_s))
    slips = [b.first for a, b in pairwise(found)]
    silent, unanswered = _silent(rows, steps, tau_i, settings)
    agreed, share = _agreed(rows, found, gains.direction, tau_i, settings, unanswered)
    # How far plateaus and steps are what pv consists of: from 1 on they are
    left = rows.pv - steps.fitted
    noise = settings.remainder * steps.sigma / max(float(np.std(left)), SILENT)
    unexplained = (1 - settings.explained) * float(np.var(rows.pv))
    explained = max(noise, unexplained / max(float(np.var(left)), SILENT))
    dead = any(leg.travel >= settings.dead_travel and leg.dwell >= settings.dead_dwell for leg in counted)
    idle = sum(leg.travel * _up_to(leg.travel, settings.travel) for leg in legs)
    dwell = max((leg.dwell * _up_to(leg.travel, settings.travel) for leg in legs), default=0.0)
    lasts = max(settings.dwell, WAVE * steps.lag / tau_i)
    degree = min(_up_to(idle, settings.idle), _up_to(dwell, lasts), _up_to(share, AGREEING), _up_to(explained, 1.0))
    stands = degree >= 1.0 and len(counted) >= settings.legs and sum(leg.travel for leg in counted) >= settings.idle
    quick = 1.0 if silent else _up_to(settings.quick * tau_i, max(steps.lag, NO_LAG))
    verdicts = stands, stands and quick >= 1.0, dead and not slips, degree, quick
    slips_s = tuple(float(rows.t_s[s]) for s in slips)
    ends_s = tuple(_ends(agreed, counted))
    return StandStill(counted, slips_s, len(agreed), ends_s, *verdicts, len(rows.pv), steps.sigma, steps.criterion)


def _up_to(value: float, bound: float) -> float:
    """How far a number is on its way to its bound: 0 up to half of it, 1 from it on."""
    return min(max(2.0 * value / bound - 1.0, 0.0), 1.0)


WAVE = 5.0  # lags of its slips that pv must stand at the longest: shorter, plateaus are what a slow swing leaves
AGREEING, NO_LAG, SILENT = 2.0 / 3.0, 1e-9, 1e-300
"""Share of slips that go where co had gone, from which all do but for chance; a lag, and a remainder, that are none."""


def _thinned(window: Window) -> Window:
    """The record in at most MOST_ROWS rows, each the mean of several samples."""
    n = -(-len(window.t_s) // MOST_ROWS)
    if n == 1:
        return window
    m = len(window.t_s) // n
    means = [x[: m * n].reshape(m, n).mean(axis=1) for x in (window.t_s, window.sp, window.pv, window.co)]
    return Window(*means)


def _legs(
    rows: Window, plateau: Plateau, steps: Steps, gains: PidGains, tau_i: float, settings: StandStillSettings
) -> list[Leg]:
    """The legs on one plateau. tau_i : in rows."""
    inside = slice(plateau.first, plateau.last)
    if plateau.last - plateau.first < FEWEST_ROWS:
        return []
    width = max(len(rows.pv) // SMOOTHED, 1)
    error = running_mean((rows.sp - rows.pv)[inside], width)
    pv_range, co_range = float(np.ptp(rows.pv)), float(np.ptp(rows.co))
    found = []
    for sign in (1.0, -1.0):
        for first, end in runs(sign * error > 0):
            n = end - first
            if n < FEWEST_ROWS:
                continue
            a, b = plateau.first + first, plateau.first + end
            mean = float(np.mean(rows.sp[a:b] - rows.pv[a:b]))
            least = max(settings.leg_sigmas * steps.sigma * (3 / n) ** 0.5, settings.leg_error * pv_range)
            ends = max(n // 5, 1)
            drift = abs(float(np.mean(rows.pv[b - ends : b]) - np.mean(rows.pv[a : a + ends])))
            moved = float(rows.co[b - 1] - rows.co[a])
            follows = moved * sign * np.sign(gains.ki) > 0
            if abs(mean) > least and drift < max(settings.drift * pv_range, 3 * steps.sigma) and follows:
                times = float(rows.t_s[a]), float(rows.t_s[b - 1])
                found.append(Leg(*times, abs(moved) / co_range, n / tau_i))
    return found


def _agreed(
    rows: Window, found: Sequence[Plateau], direction: int, tau_i: float, settings: StandStillSettings,
    unanswered: float = 0.0,
) -> tuple[list[float], float]:  # fmt: skip
    """When pv steps from plateau to plateau the way that co has gone before, s; and the share of all steps that do so,
    by their squares and by how far co had gone.

    One that follows the setpoint at once says nothing of a valve that need not have turned. tau_i : in rows.
    unanswered : squares of setpoint steps that pv has not answered; co had gone there as well.
    """
    least = settings.slip_travel * float(np.ptp(rows.co))
    agreed, squares, ways = [], LEAST_STEPS + unanswered, unanswered
    gone_by: list[tuple[int, float]] = []
    for before, after in pairwise(found):
        size, way = abs(after.level - before.level), np.sign(after.level - before.level)
        since = max((row for row, other in gone_by if other >= COMPARABLE * size), default=0)
        at = max(before.last, since + 1)
        co = way * direction * rows.co[since:at]
        gone, back = float(co[-1] - np.min(co)), float(np.max(co) - co[-1])
        gone_by.append((at, size))
        led = way * float(rows.sp[after.first] - rows.sp[max(before.last - round(tau_i), 0)])
        if led >= COMPARABLE * size and max(gone, back) < least:
            continue
        agreed += [float(rows.t_s[after.first])] if gone > least else []
        squares, ways = squares + size**2, ways + size**2 * _up_to(gone, least)
    return agreed, ways / squares


COMPARABLE = 0.5
"""Share of a step's size from which one before it has used up what co had gone, and from which the setpoint led it."""
LEAST_STEPS = 1e-300  # squares of steps add up to this at least


def _ends(agreed: Sequence[float], legs: Sequence[Leg]) -> list[float]:
    """The slips before which pv stood while co travelled, each since the slip before it."""
    pairs = pairwise([-np.inf, *agreed])
    return [slip for last, slip in pairs if any(last < leg.end_s <= slip for leg in legs)]


def _silent(rows: Window, steps: Steps, tau_i: float, settings: StandStillSettings) -> tuple[bool, float]:
    """Whether pv did not move for long after a setpoint step while co did, and did move in the end; and the squares of
    the steps that it has not answered yet, as far as it was long enough.
    """
    changes = runs(np.diff(rows.sp) != 0)
    co_range = float(np.ptp(rows.co))
    answered_late, squares = False, 0.0
    for (first, at), (until, _) in pairwise([*changes, (len(rows.sp) - 1, 0)]):
        step = float(rows.sp[at] - rows.sp[first])
        if not step:  # the setpoint came back at once
            continue
        moved = (rows.pv[at : until + 1] - median(rows.pv[max(at - 5, 0) : at])) / step
        if float(np.mean(moved[len(moved) // 2 :])) < settings.answered:
            seen = _up_to(abs(step), settings.step_sigmas * steps.sigma)
            gone = _up_to(abs(float(rows.co[until] - rows.co[at])), settings.pushed * co_range)
            squares += seen * gone * _up_to(until - at, settings.silent * tau_i) * step**2
            continue
        answers = np.flatnonzero(running_mean(moved, 3) > settings.answered)
        if abs(step) <= settings.step_sigmas * steps.sigma or not answers.size or answers[0] < settings.silent * tau_i:
            continue
        travel = abs(float(rows.co[at + answers[0]] - rows.co[at]))
        answered_late |= travel > settings.pushed * co_range
    return answered_late, squares
