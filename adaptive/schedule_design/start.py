"""Where to start: one process for all stretches, over a grid of lag and dead time; and load steps, one by one."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.schedule_design.joint import At, Form, Joint, Noise, local_at, white
from retuner.adaptive.schedule_design.motion import Batch, Local, push_ways, response
from retuner.adaptive.schedule_design.shapes import Axis, Second, Shape
from retuner.adaptive.schedule_design.stretches import Stretch
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray

NODES = 10
"""Lags and dead times each."""
MOST_STRETCHES = 40
"""Those that move most are searched; the refinement uses all."""
WHITENINGS: tuple[tuple[float, ...], ...] = ((), (0.97,))
"""Of the search: as measurement noise, and nearly differenced, in which slow loads weigh little. Noise beside a
controller must not be differenced: its output answers the noise at once, as if there were no dead time."""


def starts(
    stretches: Sequence[Stretch],
    axis: Axis,
    sign: int | None,
    *,
    pushed: bool = False,
    second: Second | None = None,
) -> list[Form]:
    """Constant processes to start from, one for each whitening; their z is zero, as the prior is centred on it.

    sign : of the process gain, where it is known. pushed, second : see Form.
    """
    form = Form(axis, (Shape.CONSTANT,) * 3, (0.0, 0.0, 0.0), 1, pushed=pushed, second=second)
    chosen = sorted(stretches, key=_excitation, reverse=True)[:MOST_STRETCHES]
    batch = Batch.of(chosen)
    h = float(np.median(batch.h_s))
    longest = h * max(map(len, chosen))
    lags = np.geomspace(2 * h, 3 * longest, NODES)
    thetas = np.geomspace(0.5 * h, 0.3 * longest, NODES)
    best = [(math.inf, 0.0, 0.0, 0.0)] * len(WHITENINGS)
    for theta in thetas.tolist():
        for w, found in enumerate(_searched(batch, lags, theta, form.outside(batch))):
            nodes = zip(lags.tolist(), found, strict=True)
            right = [(cost, slope, theta, lag) for lag, (cost, slope) in nodes if sign is None or slope * sign > 0]
            best[w] = min(best[w], *right, (math.inf, 0.0, 0.0, 0.0))
    found_any = [node for node in dict.fromkeys(best) if node[0] < math.inf]
    if not found_any:
        raise ValueError("pv goes against co everywhere, where the controller says otherwise: are the columns right?")
    return [_constant(form, *node[1:]) for node in found_any]


def _constant(form: Form, slope: float, theta: float, lag: float) -> Form:
    centre = (math.log(max(abs(slope), 1e-300)), math.log(theta), math.log(lag))
    return replace(form, centre=centre, sign=1 if slope >= 0 else -1)


def _excitation(stretch: Stretch) -> float:
    return float(np.ptp(stretch.pv)) / max(noise_sigma(stretch.pv), 1e-12 * float(np.ptp(stretch.pv)) + 1e-300)


def _searched(
    batch: Batch, lags: FloatArray, theta: float, outside: Sequence[FloatArray]
) -> list[list[tuple[float, float]]]:
    """Misfit and slope gain for each whitening and lag, at one dead time."""
    shape = (len(batch.pv), len(batch.stretches), len(lags))
    ln_tau = np.broadcast_to(np.log(lags), shape)
    local = Local(np.zeros(shape), np.full(shape, math.log(theta)), ln_tau, None)
    arriving = np.repeat(batch.arriving(np.full((*shape[:2], 1), theta)), len(lags), axis=2)
    moved = response(local, arriving, batch.h_s)
    begun = response(local, np.zeros_like(arriving), batch.h_s, np.ones(shape[1:]))
    beside = np.stack([begun, *push_ways(batch, local, outside)], axis=-1)
    return [[_node(batch, moved[..., i], beside[..., i, :], ar) for i in range(len(lags))] for ar in WHITENINGS]


def _node(batch: Batch, moved: FloatArray, beside: FloatArray, ar: Sequence[float]) -> tuple[float, float]:
    """Misfit and slope gain of one process, start and slope of every stretch, and its push, solved for."""
    xx = xy = yy = 0.0
    for j, stretch in enumerate(batch.stretches):
        n = len(stretch)
        columns = np.stack([np.ones(n), *beside[:n, j].T, moved[:n, j], batch.pv[:n, j]], axis=1)
        triangle = np.linalg.qr(white(columns, ar) / max(noise_sigma(stretch.pv), 1e-9))[1]
        a, b, c = triangle[-2, -2], triangle[-2, -1], triangle[-1, -1]
        xx, xy, yy = xx + a**2, xy + a * b, yy + b**2 + c**2
    slope = float(xy / max(xx, 1e-300))
    return float(yy - xy * slope), slope


COARSE = 6
"""Every so many rows a load step is tried, then every row near the best."""
MOST_LOADS = 4
"""In a stretch."""
PRICE = 12.0
"""Fall of the misfit, beyond 2 ln n, that a load step must bring."""


def with_loads(joint: Joint, form: Form, now: At, noise: Noise) -> Joint:
    """The stretches with the load steps that pay for the curves as they are at `now`."""
    loads: list[tuple[int, ...]] = []
    done = 0
    for batch in joint.batches:
        local = local_at(form, batch, now.z[:, None])
        arriving = form.arriving(batch, local, now.z[:, None])
        explained = (response(local, arriving, batch.h_s) + form.drift(batch, local, now.z[:, None]))[..., 0]
        waves = _waves(batch, local, form.outside(batch))
        theta, tau = (
            float(np.exp(np.median(p))) for p in (local.theta, local.b * 0 if local.tau is None else local.tau)
        )
        for j, stretch in enumerate(batch.stretches):
            n, h = len(stretch), stretch.signals.h_s
            y = white(stretch.pv - explained[:n, j], noise.ar) / noise.sigma[done]
            rest = [np.ones(n), *waves[0][:n, j].T]
            columns = white(np.stack(rest, axis=1), noise.ar) / noise.sigma[done]
            barred = int((2 * theta + 0.2 * tau) / h) + 4 if stretch.changed else 0
            steps = white(waves[1][:n, j], noise.ar) / noise.sigma[done]
            loads.append(_greedy(y, columns, steps, range(max(barred, 3), n - max(6, int(theta / h)))))
            done += 1
    return replace(joint, loads=tuple(loads))


def _waves(batch: Batch, local: Local, outside: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """What a slope at the start and the variable's push, (rows, stretches, 1 or 2), and a load step do to pv.

    A load step entering at each row: (rows, stretches, rows).
    """
    rows, count = batch.pv.shape
    steps = np.broadcast_to((np.arange(rows - 1)[:, None] >= np.arange(rows))[:, None, :], (rows - 1, count, rows))
    loads = response(local.repeated(rows), steps.astype(np.float64), batch.h_s)
    begun = response(local, np.zeros((rows - 1, count, 1)), batch.h_s, np.ones((count, 1)))
    return np.concatenate([begun, *push_ways(batch, local, outside)], axis=2), loads


def _greedy(y: FloatArray, columns: FloatArray, steps: FloatArray, allowed: range) -> tuple[int, ...]:
    """Rows of the load steps that pay, one after the other, none within COARSE rows of another."""
    chosen: list[int] = []
    price = PRICE + 2 * math.log(max(len(y), 2))
    while len(chosen) < 2 * MOST_LOADS:
        q = np.linalg.qr(np.concatenate([columns, steps[:, chosen]], axis=1))[0]
        left = y - q @ (q.T @ y)
        free = [row for row in allowed if all(abs(row - c) > COARSE for c in chosen)]
        if not free:
            break
        tried = steps[:, free] - q @ (q.T @ steps[:, free])
        size = np.einsum("ij,ij->j", tried, tried)
        fall = np.where(size > 1e-9, (left @ tried) ** 2 / np.maximum(size, 1e-300), 0.0)
        best = int(np.argmax(fall))
        if fall[best] < price:
            break
        chosen += [free[best], free[best] + 1]  # between the two lies the time at which it entered
    return tuple(sorted(chosen))
