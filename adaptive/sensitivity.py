"""Ms of the common kind of loop in a dozen evaluations of L: what on-line work asks for many models.

Where every zero has a slower pole of its own (an integrator counts as the slowest), |L| falls all the way. Then there
is one gain crossover wc; the loop is stable just when the unwrapped phase there is within (-pi, pi); and beyond the
first phase crossover w180 no |S| is higher than at it, because |S| <= 1/(1 - |L|). So the peak lies below w180, and
within 1 - 1/Ms < |L| < 1 + 1/Ms. The march goes from wc both ways until it leaves that band; the best point is refined
by Newton's method on d ln|1 + L|^2 / d ln w, whose derivatives are known in closed form.
"""

import math

from retuner.adaptive.open_loop import OpenLoop

STEP = 1.3
"""Ratio of neighbouring frequencies on the march; peaks of |S| are at least as wide unless they are at wc itself."""
DELAY_STEP = 0.45
"""Largest turn in rad of the dead time from one point to the next."""
NEGLIGIBLE = 1e-6
"""|L| below which 1 - |L| < |S| < 1 + |L| is 1 for every purpose."""
CROSSOVER_ACCURACY = 1e-13
"""Relative accuracy of wc, on which the sign of the phase margin hangs."""
MOST_STEPS = 200
"""Points on the march before the general method is asked instead."""


def falls_everywhere(loop: OpenLoop) -> bool:
    """Whether |L| is known to fall from infinity all the way: every zero has a slower pole."""
    least = 0 if loop.theta else 1
    if loop.quadratics or loop.order < 1 or loop.k <= 0 or loop.excess < least:
        return False
    zeros = [abs(x) for x in loop.leads]
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
    if loop.end_size >= 1:
        return math.inf
    wc = _crossover(loop)
    if wc is None:
        return None
    if not -math.pi < loop.phase_at(wc) < math.pi:
        return math.inf
    at = loop.at
    best_w, best = wc, abs(1 + at(wc))
    marched = _march(loop, wc, best_w, best)
    if marched is None:
        return None
    best_w, best = marched
    return max(1.0, _refined(loop, best_w, best))


def _crossover(loop: OpenLoop) -> float | None:
    """wc by Newton's method in ln w, on ln |L|."""
    squares = [(x * x, 1.0) for x in loop.leads] + [(x * x, -1.0) for x in loop.lags]
    b1_2, b2, order = loop.b1 * loop.b1, loop.b2, loop.order
    base = 2 * math.log(loop.k)
    u = base / order
    for _ in range(40):
        x = math.exp(u)  # w^2
        numerator = (1 - b2 * x) ** 2 + b1_2 * x
        value = base - order * u + math.log(numerator)
        slope = -order + x * (b1_2 - 2 * b2 * (1 - b2 * x)) / numerator
        for square, sign in squares:
            y = square * x
            value += sign * math.log1p(y)
            slope += sign * y / (1 + y)
        step = value / slope
        u -= max(-3.0, min(3.0, step))
        if abs(step) < CROSSOVER_ACCURACY * max(1.0, abs(u)):
            return math.exp(u / 2)
    return None


def _march(loop: OpenLoop, wc: float, best_w: float, best: float) -> tuple[float, float] | None:
    """Frequency and |1 + L| of the best point between w180 and the end of the band (see the head of this file)."""
    at, stride = loop.at, DELAY_STEP / loop.theta if loop.theta else math.inf
    w = wc
    for _ in range(MOST_STEPS):
        w = min(w * STEP, w + stride)
        value = at(w)
        size = abs(1 + value)
        if size < best:
            best_w, best = w, size
        past = value.imag >= 0 > value.real and loop.theta > 0  # beyond w180
        if past or abs(value) < max(NEGLIGIBLE, 1 - best):
            break
    else:
        return None
    w = wc
    for _ in range(MOST_STEPS):
        w = w / STEP
        value = at(w)
        size = abs(1 + value)
        if size < best:
            best_w, best = w, size
        if abs(value) > 1 + best:
            return best_w, best
    return None


def _refined(loop: OpenLoop, w: float, best: float) -> float:
    """|S| at the peak nearest w, by Newton's method; the point itself where that leads away."""
    u = math.log(w)
    low, high = u - math.log(STEP), u + math.log(STEP)
    for _ in range(8):
        s = complex(0.0, math.exp(u))
        value = loop.at(s.imag)
        rate, bend = _derivatives(loop, s)
        sum_, turn = 1 + value, value * rate
        first = (sum_.conjugate() * turn).real
        second = abs(turn) ** 2 + (sum_.conjugate() * (turn * rate + value * bend)).real
        best = min(best, abs(sum_))
        if second <= 0:
            break
        step = first / second
        u = min(high, max(low, u - step))
        if abs(step) < 1e-6:
            break
    return 1 / best


def _derivatives(loop: OpenLoop, s: complex) -> tuple[complex, complex]:
    """d ln L / d ln w and its derivative with respect to ln w."""
    rate, bend = complex(-loop.order) - loop.theta * s, -loop.theta * s
    b2s = loop.b2 * s * s
    numerator = 1 + loop.b1 * s + b2s
    first = (loop.b1 * s + 2 * b2s) / numerator
    rate += first
    bend += (loop.b1 * s + 4 * b2s) / numerator - first * first
    for lead in loop.leads:
        x = lead * s / (1 + lead * s)
        rate, bend = rate + x, bend + x * (1 - x)
    for lag in loop.lags:
        x = lag * s / (1 + lag * s)
        rate, bend = rate - x, bend - x * (1 - x)
    return rate, bend
