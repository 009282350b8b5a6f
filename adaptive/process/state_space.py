"""A linear process without its dead time as states:  dx/dt = A x + B v,  y = C x + D v.

Built as a cascade of first and second order sections, each with the zeros that fit into it, so that time constants far
apart do no harm (a polynomial of high order would lose digits).
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray


@dataclass(frozen=True, slots=True)
class StateSpace:
    """A, B, C of shapes (n, n), (n,), (n,) and the number D; time in units of the builder's choice."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: float


def state_space(process: LinearProcess, unit_s: float) -> StateSpace:
    """The process without its dead time; time counts in units of unit_s seconds.

    Raises
    ------
    ValueError
        The process has more zeros than poles, so no real plant can be it.
    """
    sections = _sections(process, unit_s)
    n = sum(len(section) - 1 for section, _ in sections)
    a, b, c, d = np.zeros((n, n)), np.zeros(n), np.zeros(n), 1.0
    first = 0
    for rates, zeros in sections:
        # Drive a section from the signal c x + d v; the row and number of its output
        last = first + len(rates) - 2
        if last > first:
            a[first, last] = 1.0
        a[last] += c / rates[-1]
        b[last] = d / rates[-1]
        for j, rate in enumerate(rates[:-1]):
            a[last, first + j] -= rate / rates[-1]
        powers = np.array([1.0, sum(zeros), zeros[0] * zeros[1] if len(zeros) == 2 else 0.0])
        row, number = np.zeros(len(b)), 0.0
        row[first] = 1.0
        for order in range(1, len(zeros) + 1):
            if order == len(rates) - 1:  # the highest derivative is the right hand side itself
                row, number = row + powers[order] * a[last], number + powers[order] * b[last]
            else:
                row[first + order] += powers[order]
        c, d = row, number
        first += len(rates) - 1
    gain = process.k * unit_s**process.integrators
    return StateSpace(a, b, gain * c, gain * d)


Section = tuple[tuple[float, ...], list[float]]
"""Denominator coefficients a0 + a1 s (+ a2 s^2), and the zeros' time constants put into the section."""


def _sections(process: LinearProcess, unit_s: float) -> list[Section]:
    """The cascade: fastest poles first, so that rates of the output cancel no digits; slow zeros go to slow poles."""
    lags = [x / unit_s for x in process.lags_s if x]
    lags = sorted([*lags, *(c1 / unit_s for c1, c2 in process.quadratics if c2 == 0 and c1)])
    pairs = [(1.0, c1 / unit_s, c2 / unit_s**2) for c1, c2 in process.quadratics if c2]
    sections: list[Section] = [((1.0, lag), []) for lag in lags] + [(pair, []) for pair in pairs]
    sections += [((0.0, 1.0), []) for _ in range(process.integrators)]
    zeros = sorted((x / unit_s for x in process.leads_s if x), key=abs, reverse=True)
    for rates, held in reversed(sections):
        held += [zeros.pop(0) for _ in range(min(len(rates) - 1, len(zeros)))]
    if zeros:
        raise ValueError("the process has more zeros than poles: its response to a step is not a function; add lags")
    return sections
