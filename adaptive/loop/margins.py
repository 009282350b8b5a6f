"""Robustness of a loop: stability, gain, phase and delay margin, Ms and Mt, with the dead time exact.

    L = C G,   S = 1 / (1 + L),   T = L / (1 + L),   Ms = max |S|,   Mt = max |T|

No Pade approximation. Crossovers are found on L's closed-form size and phase (open_loop.py), stability follows from
them. A grid only finds where the peaks of |S| and |T| are; each is then refined. The limits at zero and
infinite frequency count too.

Ms of the common kind of loop in a dozen evaluations of L: what on-line work asks for many models.

Where every zero has a slower pole of its own (an integrator counts as the slowest), |L| falls all the way. Then there
is one gain crossover wc; the loop is stable just when the unwrapped phase there is within (-pi, pi); and beyond the
first phase crossover w180 no |S| is higher than at it, because |S| <= 1/(1 - |L|). So the peak lies below w180, and
within 1 - 1/Ms < |L| < 1 + 1/Ms. The march goes from wc both ways until it leaves that band; the best point is refined
by Newton's method on d ln|1 + L|^2 / d ln w, whose derivatives are known in closed form.
"""

import cmath
import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from retuner.adaptive.loop.open_loop import (
    PHASE_AT_INFINITY,
    OpenLoop,
    gain_crossovers,
    grid,
    is_stable,
    open_loop,
    phase_crossovers,
)
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values

# ---- Ms of the common kind of loop in a dozen evaluations of L

STEP = 1.7
"""Ratio of neighbouring frequencies on the march; peaks of |S| are at least as wide unless they are at wc itself."""
GROWTH = STEP - 1
DELAY_STEP = 0.8  # Largest turn in rad of the dead time from one point to the next
NEGLIGIBLE = 1e-6  # |L| below which 1 - |L| < |S| < 1 + |L| is 1 for every purpose
CROSSOVER_STEP = 1e-6  # newton step in ln w^2 after which wc is right to its square, 1e-12
MOST_NEWTON_CROSSOVER = 40
CLOSE = 2e-4  # Newton step in ln w after which the value is right to its square, 4e-8, and with the correction to 1e-10
MOST_NEWTON = 12
BEYOND = 100.0  # A longer step leaves any bracket: where |S| is all but flat, its exponential would be no number
WORTH = 1.2  # local minima of |1 + L| on the march up to this factor above the least one are refined too
MOST_STEPS = 200  # points on the march before the general method is asked instead


def falls_everywhere(loop: OpenLoop) -> bool:
    """Whether |L| is known to fall from infinity all the way: every zero has a slower pole."""
    k, order, _, b2, leads, lags, quadratics, theta = loop
    if quadratics or order < 1 or k <= 0:
        return False
    if not leads and not b2 and (lags or order > 1):
        return True  # PI on lags or integrators: nothing to compare
    if loop.excess < (0 if theta else 1):
        return False
    zeros = [abs(x) for x in leads]
    if loop.b2:
        root = loop.b1 * loop.b1 - 4 * loop.b2
        if root < 0:
            return False
        larger = (loop.b1 + math.sqrt(root)) / 2
        zeros += [larger, loop.b2 / larger]
    elif loop.b1:
        zeros.append(loop.b1)
    if len(zeros) <= loop.order:
        return True
    zeros.sort(reverse=True)
    slower = sorted(loop.lags, reverse=True)
    return all(z <= lag for z, lag in zip(zeros[loop.order :], slower, strict=False)) and len(
        zeros
    ) <= loop.order + len(slower)


def falling_peak(loop: OpenLoop) -> float | None:
    """Ms of such a loop, infinite when it is unstable; None when the loop is of another kind."""
    if not falls_everywhere(loop):
        return None
    if (loop.b2 or loop.leads or not loop.lags) and loop.excess == 0 and loop.end_size >= 1:
        return math.inf
    wc = _crossover(loop)
    if wc is None:
        return None
    at = _evaluator(loop)
    start = at(wc)
    # whether the unwrapped phase at wc is within (-pi, pi)
    if not loop.leads and not loop.b2 and (loop.order + len(loop.lags)) * RIGHT_ANGLE + loop.theta * wc < FULL_TURN:
        stable = start.imag < 0  # the phase is between -2 pi and 0
    else:
        stable = -math.pi < loop.phase_at(wc) < math.pi
    if not stable:
        return math.inf
    marched = _march(at, wc, start, loop.theta)
    if marched is None:
        return None
    points, least = marched
    worth, best = WORTH * least, 1.0
    before, (size, w) = math.inf, points[0]
    for after, next_w in (*points[1:], END):
        if size <= worth and before >= size <= after:
            bend = before - 2 * size + after  # of a parabola through three points a STEP apart (or less: then nearly)
            vertex = w * STEP ** (0.5 * (before - after) / bend) if 0 < bend < math.inf else w
            best = max(best, _refined(loop, vertex, size))
        before, size, w = size, after, next_w
    return best


def _crossover(loop: OpenLoop) -> float | None:
    """wc: the root of a quadratic in w^2 for PI on two poles in all, else by Newton's method in ln w^2, on ln |L|^2."""
    k, order, b1, b2, leads, lags, _, _ = loop
    b1_2 = b1 * b1
    if order + len(lags) == 2 and not leads and not b2:
        square, k_2 = lags[0] * lags[0] if lags else 1.0, k * k
        middle = (1.0 if lags else 0.0) - k_2 * b1_2  # square x^2 + middle x - k_2 = 0
        root = math.sqrt(middle * middle + 4 * square * k_2)
        return math.sqrt((root - middle) / (2 * square) if middle < 0 else 2 * k_2 / (root + middle))
    base = 2 * math.log(k)
    u = base / order
    for _ in range(MOST_NEWTON_CROSSOVER):
        x = math.exp(u)  # w^2
        real = 1 - b2 * x
        numerator = real * real + b1_2 * x
        slope = x * (b1_2 - 2 * b2 * real) / numerator - order
        for lead in leads:
            y = lead * lead * x
            numerator *= 1 + y
            slope += y / (1 + y)
        value = base - order * u + math.log(numerator)
        for lag in lags:
            y = lag * lag * x
            value -= math.log1p(y)
            slope -= y / (1 + y)
        step = value / slope
        u -= step if -3 < step < 3 else math.copysign(3.0, step)
        if -CROSSOVER_STEP < step < CROSSOVER_STEP:
            return math.exp(u / 2)
    return None


Evaluator = Callable[[float], complex]


def _evaluator(loop: OpenLoop) -> Evaluator:
    """L(jw) as a function with everything at hand; OpenLoop.at, twice as fast."""
    k, order, b1, b2, leads, lags, _, theta = loop
    minus_theta, rect = -theta, cmath.rect

    def at(w: float) -> complex:
        s = complex(0.0, w)
        value = (1 + s * (b1 + s * b2)) * rect(k, minus_theta * w)
        for lead in leads:
            value *= 1 + lead * s
        below = s
        for lag in lags:
            below *= 1 + lag * s
        return value / below if order == 1 else value / (below * s ** (order - 1))

    return at


Point = tuple[float, float]  # |1 + L| and frequency
END = (math.inf, math.inf)
RIGHT_ANGLE, FULL_TURN = math.pi / 2, 2 * math.pi


def _march(at: Evaluator, wc: float, start: complex, theta: float) -> tuple[list[Point], float] | None:
    """Points from the end of the band to w180 (see the head of this file), by frequency, and the least |1 + L|."""
    best = abs(1 + start)
    above, below, w = [(best, wc)], [], wc
    stride = DELAY_STEP / theta if theta else math.inf
    for _ in range(MOST_STEPS):
        grown = w * GROWTH
        w += grown if grown < stride else stride
        value = at(w)
        size = abs(1 + value)
        above.append((size, w))
        best = size if size < best else best
        falling = abs(value)
        if falling < 1 - best or value.imag >= 0 > value.real or falling < NEGLIGIBLE:  # end of the band, or w180
            break
    else:
        return None
    w = wc
    for _ in range(MOST_STEPS):
        w /= STEP
        value = at(w)
        size = abs(1 + value)
        below.append((size, w))
        best = size if size < best else best
        if abs(value) > 1 + best:
            below.reverse()
            return below + above, best
    return None


def _refined(loop: OpenLoop, w: float, found: float) -> float:
    """|S| at the peak nearest w: Newton's method on |1 + L|^2, whose last step only corrects the value."""
    low, high, best = w / STEP, w * STEP, found * found
    for _ in range(MOST_NEWTON):
        value, rate, bend = _with_derivatives(loop, w)
        turn = value * rate
        bent = turn * rate + value * bend
        x, y = 1 + value.real, value.imag
        square = x * x + y * y
        first = x * turn.real + y * turn.imag
        second = turn.real * turn.real + turn.imag * turn.imag + x * bent.real + y * bent.imag
        best = square if square < best else best
        if second <= 0:
            break
        step = first / second
        if -CLOSE < step < CLOSE:
            best = min(best, square - first * step)
            break
        w = min(high, max(low, w * math.exp(max(-BEYOND, min(BEYOND, -step)))))
    return 1 / math.sqrt(best)


def _with_derivatives(loop: OpenLoop, w: float) -> tuple[complex, complex, complex]:
    """L, d ln L / d ln w, and the derivative of that with respect to ln w."""
    k, order, b1, b2, leads, lags, _, theta = loop
    s = complex(0.0, w)
    bend = -theta * s
    rate = bend - order
    b1s, b2s = b1 * s, b2 * s * s
    value = 1 + b1s + b2s
    x = (b1s + 2 * b2s) / value
    rate += x
    bend += (b1s + 4 * b2s) / value - x * x
    value *= cmath.rect(k, -theta * w)
    for lead in leads:
        y = 1 + lead * s
        value *= y
        y = 1 / y
        rate, bend = rate + (1 - y), bend + y * (1 - y)
    below = s if order == 1 else s**order
    for lag in lags:
        y = 1 + lag * s
        below *= y
        y = 1 / y
        rate, bend = rate - (1 - y), bend - y * (1 - y)
    return value / below, rate, bend


EDGE = 50.0
"""Ms from which its digits say nothing: the loop is at the edge of instability, its gain margin at most some 1.02."""
PEAKS_LOOKED_AT = 6  # how many local peaks of the grid are refined, from the highest down
ZOOMS, ZOOM_POINTS = 5, 21
"""Refinements of a peak: each cuts its bracket to a tenth, so the value is right to about 1e-10."""
ZOOM_SHARES = np.linspace(0.0, 1.0, ZOOM_POINTS)  # where the points of a refinement lie in their bracket, in logarithms


@dataclass(frozen=True, slots=True)
class Margins:
    """Robustness of one loop. Frequencies in rad/s; infinite where there is no crossing.

    stable : the closed loop is stable; if not, ms and mt are infinite and the margins are not to be used.
    ms, mt : maximum of the sensitivity and of the complementary sensitivity.
    gm : factor by which the gain may rise. pm_deg : smallest phase margin. delay_margin_s : dead time to spare.
    w180 : phase crossover at which gm is read. wc : gain crossover at which pm_deg is read.
    """

    stable: bool
    ms: float
    mt: float
    gm: float
    pm_deg: float
    delay_margin_s: float
    w180: float
    wc: float

    def to_dict(self) -> dict[str, float | bool | None]:
        """Keys as in every JSON output; null where a value is infinite, and for all of an unstable loop."""
        known = plain_values(self, "ms mt gm pm_deg delay_margin=delay_margin_s w180 wc")
        return (known if self.stable else dict.fromkeys(known)) | {"stable": self.stable}


UNSTABLE = Margins(
    stable=False, ms=math.inf, mt=math.inf, gm=0.0, pm_deg=0.0, delay_margin_s=0.0, w180=math.inf, wc=math.inf
)


@lru_cache(maxsize=256)
def margins(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> Margins:
    """All margins of a process under these gains.

    Parameters
    ----------
    process : as ProcessModel.linear() or LinearProcess gives it. gains : of the controller, co units per pv unit.
    tau_f_s : filter time of the derivative in seconds.

    Returns
    -------
    Margins
        Ms, Mt, gain margin, phase margin in degrees and delay margin in seconds; `stable` is False for a loop without
        them.

    Examples
    --------
    >>> from retuner import LinearProcess, PidGains
    >>> round(margins(LinearProcess(k=2.0, lags_s=(30.0,), theta_s=5.0), PidGains(1.5, 0.05)).ms, 2)
    1.59
    """
    loop = open_loop(process, gains, tau_f_s)
    w = grid(loop)
    crossed = gain_crossovers(loop, w)
    if not is_stable(loop, crossed):
        return UNSTABLE
    w180s = phase_crossovers(loop, w)
    at_zero, at_end = _ends(loop)
    points = np.sort(np.concatenate([w, crossed, w180s]))
    ms = _peak(lambda x: 1 / np.abs(1 + loop.along(x)), points, at_zero[0], at_end[0])
    mt = _peak(lambda x: 1 / np.abs(1 + 1 / loop.along(x)), points, at_zero[1], at_end[1])
    w180, gm = _gain_margin(loop, w180s)
    wc, pm_rad, delay_s = math.inf, math.inf, 0.0 if loop.end_size >= 1 else math.inf
    if crossed:
        angles = [math.atan2(-value.imag, -value.real) for value in map(loop.at, crossed)]
        pm_rad, wc = min((abs(angle), w) for angle, w in zip(angles, crossed, strict=True))
        least_s = min(angle % (2 * math.pi) / w for angle, w in zip(angles, crossed, strict=True))
        delay_s = 0.0 if loop.end_size >= 1 else least_s
    return Margins(
        stable=True, ms=ms, mt=mt, gm=gm, pm_deg=math.degrees(pm_rad), delay_margin_s=delay_s, w180=w180, wc=wc
    )


@lru_cache(maxsize=1024)  # of a decision's questions two thirds are asked again
def sensitivity_peak(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> float:
    """Ms alone, infinite when the closed loop is unstable: what the guard asks for many models."""
    loop = open_loop(process, gains, tau_f_s)
    quick = falling_peak(loop)
    if quick is not None:
        return quick
    w = grid(loop)
    crossed = gain_crossovers(loop, w)
    if not is_stable(loop, crossed):
        return math.inf
    points = np.sort(np.concatenate([w, crossed, phase_crossovers(loop, w)]))
    at_zero, at_end = _ends(loop)
    return _peak(lambda x: 1 / np.abs(1 + loop.along(x)), points, at_zero[0], at_end[0])


def gain_margin(process: LinearProcess, gains: PidGains) -> float:
    """GM alone, 0 when the closed loop is unstable."""
    loop = open_loop(process, gains)
    w = grid(loop)
    return _gain_margin(loop, phase_crossovers(loop, w))[1] if is_stable(loop, gain_crossovers(loop, w)) else 0.0


def _ends(loop: OpenLoop) -> tuple[tuple[float, float], tuple[float, float]]:
    """|S| and |T| at zero frequency, and their largest values in the limit of high frequency."""
    if loop.order > 0:
        zero = (0.0, 1.0)
    else:
        start = loop.k if loop.order == 0 else 0.0
        zero = (1 / abs(1 + start), abs(start / (1 + start)))
    size = loop.end_size
    if size == math.inf:
        return zero, (0.0, 1.0)
    if loop.theta or size == 0:
        return zero, (1 / (1 - size), size / (1 - size))
    sign = math.cos(loop.phase_at(PHASE_AT_INFINITY * max(loop.corners())))
    end = math.copysign(size, sign)
    return zero, (1 / abs(1 + end), abs(end / (1 + end)))


def _peak(size: Callable[[FloatArray], FloatArray], w: FloatArray, *limits: float) -> float:
    """Largest value of size(w): the highest local peaks of the points, refined, and the limits at the ends.

    Infinite where a value is not a number: Python's max passes over one, and what cannot be told would be robust.
    """
    values = size(w)
    inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    highest = inner[np.argsort(values[inner])[::-1][:PEAKS_LOOKED_AT]]
    found = [*limits, float(np.max(values))]
    for i in highest:
        fine, heights = w[i - 1 : i + 2], values[i - 1 : i + 2]
        for _ in range(ZOOMS):
            j = int(np.argmax(heights))
            low, high = float(fine[max(j - 1, 0)]), float(fine[min(j + 1, len(fine) - 1)])
            fine = low * (high / low) ** ZOOM_SHARES  # np.geomspace looks at its arguments for longer than it computes
            heights = size(fine)
        found.append(float(np.max(heights)))
    return math.inf if any(map(math.isnan, found)) else max(found)


def _gain_margin(loop: OpenLoop, crossings: list[float]) -> tuple[float, float]:
    """Smallest factor by which the gain may rise, and the phase crossover where it would do harm."""
    sizes = [(abs(loop.at(w)), -w) for w in crossings]
    size, minus_w = max((pair for pair in sizes if pair[0] < 1), default=(0.0, -math.inf))
    if loop.theta and loop.end_size > size:
        return math.inf, 1 / loop.end_size
    return -minus_w, 1 / size if size else math.inf


# Ultimate gain and period of a process: where a proportional controller brings it to the limit of stability.
#
# Exact: w180 is found on the closed-form phase, with the dead time in it.
#
# Ku = 1 / |G(j w180)|,   Pu = 2 pi / w180,   w180 the crossover of phase -180 degrees with the largest |G|


JUST_BELOW = 1 - 1e-6  # share of Ku at which the loop must still be stable


def ultimate(process: LinearProcess) -> tuple[float, float]:
    """Ku in co units per pv unit (negative for a reverse-acting process) and Pu in seconds.

    Raises ValueError: proportional control never makes the process swing, or never makes it stable.
    """
    sign = math.copysign(1.0, process.k)
    loop = open_loop(process, PidGains(sign, 0.0))
    sizes = [(abs(loop.at(w)), w) for w in phase_crossovers(loop, grid(loop))]
    if not sizes:
        raise ValueError("this process has no ultimate gain: its phase never falls to -180 degrees; use another rule")
    size, w = max(sizes)
    gain = sign / size
    if not margins(process, PidGains(gain * JUST_BELOW, 0.0)).stable:
        raise ValueError("this process is not held by proportional control, so it has no ultimate gain")
    return gain, 2 * math.pi / w
