"""Exact stepping of a loop with dead time: one dead time after the other (the method of steps).

Within one dead time the process input is known, since it left the controller a dead time earlier, so the states follow
a linear differential equation with a given input. It is solved by Radau collocation of order 2p - 1 on elements graded
towards the start of the step, where fast lags leave their boundary layers. All of it is linear, so one dead time
is one matrix on the vector

    q = (X, u at all nodes of the last dead time, weight of the impulse waiting, 1)

and powers of that matrix step as far as one likes. Nothing is approximated but by polynomials of high degree: the error
is far below 1e-6 (Bellen & Zennaro, Numerical methods for delay differential equations, 2003, chapter 4).
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import legendre

from retuner.adaptive.closed_loop import CutLoop
from retuner.adaptive.sample import FloatArray

NODES = 9
"""Nodes p in an element."""
FINE = 33
"""Points in an element at which signals are looked at."""
LAYER = 3.0
"""First element over the fastest time constant; 9 nodes resolve exp(-3 x) to 1e-9."""
GRADING = 4.0
"""Ratio of the lengths of neighbouring elements."""
FASTEST = 1e-5
"""Time constants below this share of the dead time are not resolved; they hold no area worth counting."""


@dataclass(frozen=True, slots=True)
class Collocation:
    """Matrices of an element of length 1: from values at the p nodes to the integral there, and to fine points.

    integral : (p, p). fine, slope, sums : (FINE, p) value, derivative and integral at the fine points.
    """

    integral: FloatArray
    fine: FloatArray
    slope: FloatArray
    sums: FloatArray


@cache
def collocation() -> Collocation:
    """Radau IIA nodes (zeros of P_p - P_{p-1}, right end included) and their matrices, by Legendre polynomials."""
    zeros = legendre.legroots(np.concatenate([np.zeros(NODES - 1), [-1.0, 1.0]]))
    x = np.sort(np.real(zeros))
    values = legendre.legvander(x, NODES - 1)
    unit = np.eye(NODES)
    points, integrals = np.linspace(-1, 1, FINE), [legendre.legint(row, lbnd=-1) for row in unit]
    integral = np.array([legendre.legval(x, row) for row in integrals]).T / 2
    sums = np.array([legendre.legval(points, row) for row in integrals]).T / 2
    slopes = np.array([legendre.legval(points, legendre.legder(row)) for row in unit]).T * 2
    inverse = np.linalg.inv(values)
    fine = legendre.legvander(points, NODES - 1)
    return Collocation(integral @ inverse, fine @ inverse, slopes @ inverse, sums @ inverse)


def elements(fastest: float) -> FloatArray:
    """Lengths of the elements of one dead time (sum 1) when the fastest time constant is this share of it."""
    length = LAYER * max(fastest, FASTEST)
    if length >= 1:
        return np.array([1.0])
    count = max(1, math.ceil(math.log(1 / length, GRADING)))
    edges = np.concatenate([[0.0], np.geomspace(length, 1.0, count + 1)])
    return np.diff(edges)


@dataclass(frozen=True, slots=True)
class DelaySteps:
    """One dead time as matrices on q (see the head of this file).

    step : q to the next q. error, area, output, rate : (elements, FINE, len(q)) e, z, u and du/dt at the fine points.
    rate_start : (len(q),) du/dt at the start of the dead time, free of the rounding that a short element makes.
    lengths : (elements,). start : q at time 0. kick : weight of the impulse that leaves the controller at time 0.
    """

    step: FloatArray
    error: FloatArray
    area: FloatArray
    output: FloatArray
    rate: FloatArray
    rate_start: FloatArray
    lengths: FloatArray
    start: FloatArray
    kick: float


def delay_steps(loop: CutLoop, fastest: float, setpoint: float, load: float, *, kick: bool) -> DelaySteps:
    """The matrices for a step of the setpoint and of the load; time in dead times.

    fastest : smallest time constant of loop.a. kick : the derivative acts on the setpoint's step too.
    """
    c, lengths, n = collocation(), elements(fastest), len(loop.b)
    size = n + len(lengths) * NODES + 2
    x = np.zeros((n, size))  # the states as a function of q
    x[:, :n] = np.eye(n)
    x[:, size - 2] = loop.b
    constant = np.zeros(size)
    constant[-1] = setpoint
    errors, areas, outputs = [], [], []
    for i, h in enumerate(lengths):
        v = np.zeros((NODES, size))
        v[:, n + i * NODES : n + (i + 1) * NODES] = np.eye(NODES)
        v[:, -1] = load
        states = _element(loop, x, v, float(h), setpoint)
        error = constant - np.tensordot(loop.c, states, (0, 1)) - loop.d * v
        errors.append(c.fine @ error)
        areas.append(x[loop.z] + h * (c.sums @ error))
        outputs.append(np.tensordot(loop.u, states, (0, 1)) + loop.v * v + loop.w * constant)
        x = states[-1]
    return DelaySteps(
        step=_step(loop, x, outputs),
        error=np.stack(errors),
        area=np.stack(areas),
        output=np.stack([c.fine @ output for output in outputs]),
        rate=np.stack([(c.slope / h) @ output for h, output in zip(lengths, outputs, strict=True)]),
        rate_start=_rate_at_start(loop, float(lengths[0]), size, setpoint, load),
        lengths=lengths,
        start=np.eye(size)[-1],
        kick=loop.kd * setpoint if kick else 0.0,
    )


def _rate_at_start(loop: CutLoop, h: float, size: int, setpoint: float, load: float) -> FloatArray:
    """du/dt at the start of the dead time from the differential equation: U dX/dt + V dv/dt."""
    c, n = collocation(), len(loop.b)
    x, v, slope = np.zeros((n, size)), np.zeros(size), np.zeros(size)
    x[:, :n], x[:, size - 2] = np.eye(n), loop.b
    v[n : n + NODES], v[-1] = c.fine[0], load
    slope[n : n + NODES] = c.slope[0] / h
    moving = loop.a @ x + np.outer(loop.b, v)
    moving[:, -1] += loop.r * setpoint
    return np.asarray(loop.u @ moving + loop.v * slope, dtype=np.float64)


def _step(loop: CutLoop, last: FloatArray, outputs: list[FloatArray]) -> FloatArray:
    """q to the next q, from the states at the end of the dead time and the output at all its nodes."""
    n, size = last.shape
    step = np.zeros((size, size))
    step[:n], step[n : size - 2], step[-1, -1] = last, np.concatenate(outputs), 1.0
    step[size - 2, size - 2] = loop.impulse
    return step


def _element(loop: CutLoop, x: FloatArray, v: FloatArray, h: float, setpoint: float) -> FloatArray:
    """States at the nodes, (NODES, n, len(q)), from the states x at the element's start and the input v there."""
    q = collocation().integral
    n, size = x.shape
    forced = np.einsum("i,jk->jik", loop.b, v)
    forced[:, :, -1] += loop.r * setpoint
    right = np.broadcast_to(x, (NODES, n, size)) + h * np.tensordot(q, forced, (1, 0))
    left = np.eye(NODES * n) - h * np.kron(q, loop.a)
    solved = np.linalg.solve(left, right.reshape(NODES * n, size))
    return np.asarray(solved.reshape(NODES, n, size), dtype=np.float64)
