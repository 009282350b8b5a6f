"""The zero of a function between two points where its signs differ (Chandrupatla 1997, Adv. Eng. Software 28, 145).

Inverse quadratic interpolation where the last three points allow it, else bisection. In a file of its own because the
margins are asked for on line, and scipy.optimize takes longer to load than all of a short command.
"""

from collections.abc import Callable

RELATIVE = 4e-16
"""Accuracy asked for, relative to the larger end: rounding."""
MOST_STEPS = 120


def bracketed_root(f: Callable[[float], float], low: float, high: float, relative: float = RELATIVE) -> float:
    """x with f(x) = 0 between low and high, to this relative accuracy of the larger end.

    Raises
    ------
    ValueError
        The signs of f at both ends are the same.
    """
    b, a, fb, fa = low, high, f(low), f(high)
    if fa == 0 or fb == 0:
        return a if fa == 0 else b
    if (fa > 0) == (fb > 0):
        raise ValueError(f"f({low}) = {fb} and f({high}) = {fa} have the same sign: no zero is enclosed")
    share = 0.5
    for _ in range(MOST_STEPS):
        x = a + share * (b - a)
        fx = f(x)
        if (fx > 0) == (fa > 0):
            c, fc = a, fa
        else:
            c, b, fc, fb = b, a, fb, fa
        a, fa = x, fx
        best = a if abs(fa) < abs(fb) else b
        tolerance = relative * max(abs(low), abs(high)) / abs(b - a) if b != a else 1.0
        if fx == 0 or tolerance > 0.5:
            return best
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        share = 0.5
        if phi**2 < xi and (1 - phi) ** 2 < 1 - xi:
            share = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        share = min(1 - tolerance, max(tolerance, share))
    return best
