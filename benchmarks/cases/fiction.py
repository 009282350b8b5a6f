"""Records that invite a fiction: a valve that stands still in a fast loop, and loads that come with a setpoint change.

band anew           a valve in a fast loop that sticks over another band at every stop, under a load that wanders: one
                    to a dozen slips, no cycle
stuck and stepped   the same under setpoint steps, which the valve follows late and in one go
fast triangle       a slow triangle of a load in a fast loop in order: pv stands beside its setpoint while co travels
load after step     a load step 0.3 to 3 lags after each setpoint step, on a loop in order or with settings of a cause
"""

import math
from collections.abc import Callable

import numpy as np

from cases.making import NotClear, Plan, event_steps, labelled, record_length, scaled_record, settings, valve_record
from cases.plant import log_uniform
from cases.setting import DiagnosisCase, Loop, draw_loop
from cases.signals import KanoValve, Valve, coloured, oscillation, steps
from retuner.schedule.gains import PidGains

FAST = (0.7, 2.0)  # Samples in the dead time of a fast loop: a flow loop read every few seconds
STICKS = frozenset({"stiction", "unknown"})
SLIPS = (1, 12)
STANDS = 10.0  # Longest stand of the valve in units of tau_I, at least


def fast_loop(rng: np.random.Generator) -> tuple[Loop, PidGains]:
    """A flow loop in order."""
    loop = draw_loop(rng, str(rng.choice(["first", "second"])), FAST)
    return loop, settings(rng, loop, "ok")


class Watched:
    """A valve that keeps what it did. positions : one a sample."""

    def __init__(self, valve: Valve) -> None:
        self._valve = valve
        self.positions: list[float] = []

    def __call__(self, u: float) -> float:
        """The valve's position after the signal u."""
        self.positions.append(self._valve(u))
        return self.positions[-1]


def standing_valve(rng: np.random.Generator, *, stepped: bool) -> DiagnosisCase:
    """The first two of the page's head."""
    loop, gains = fast_loop(rng)
    n = int(rng.integers(500, 1000))
    band = loop.room * log_uniform(rng, 0.05, 0.3)
    spread, share = float(rng.uniform(0.3, 0.7)), log_uniform(rng, 0.02, 0.3)
    valve_rng = np.random.default_rng(int(rng.integers(2**31)))
    watched: list[Watched] = []

    def valve(start: float) -> Valve:
        watched.append(Watched(KanoValve(lambda: band * math.exp(spread * valve_rng.standard_normal()), share, start)))
        return watched[-1]

    walk = coloured(rng, n, n / 5) * band * float(rng.uniform(0.1, 0.5))
    sp = np.zeros(n)
    if stepped:
        sp = (
            event_steps(rng, n, 0.1 * n, int(rng.integers(2, 6)))
            * band
            * abs(loop.process.k)
            * log_uniform(rng, 0.5, 2)
        )
        walk *= 0.3
    swing = abs(loop.process.k) * band
    plan = Plan(sp, walk - walk[0], np.zeros(n), log_uniform(rng, 0.002, 0.02))
    record = valve_record(rng, loop, gains, plan, valve, swing)
    # Lengths of the stretches in which a valve stood, in samples; moves in one go count as one slip
    positions = np.array(watched[-1].positions[-n:])
    still = np.diff(positions) == 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    stands = (edges[1::2] - edges[::2]).tolist() or [0]
    if not SLIPS[0] <= len(stands) - 1 <= SLIPS[1]:
        raise NotClear
    if max(stands) * loop.dt_s < STANDS * gains.kp / gains.ki or np.ptp(record.co) > 1.8 * loop.room:
        raise NotClear
    group = "stuck and stepped" if stepped else "band anew"
    return labelled(loop, gains, record, group, set(STICKS), group, band=band, slips=len(stands) - 1)


def fast_triangle(rng: np.random.Generator) -> DiagnosisCase:
    """The third."""
    loop, gains = fast_loop(rng)
    n = int(rng.integers(500, 1000))
    shape = str(rng.choice(["triangle", "skewed-triangle"]))
    wave = oscillation(rng, n + 50, n / float(rng.uniform(0.8, 5)), shape)
    zero = np.zeros(n + 50)
    record = scaled_record(rng, loop, gains, Plan(zero, wave, zero, log_uniform(rng, 0.01, 0.15), 50))
    right = {"ok", "noise", "external", "unknown"}
    return labelled(loop, gains, record, "fast triangle", right, "ok under a triangle")


def load_after_step(rng: np.random.Generator, loop_for: Callable[[np.random.Generator, str], Loop]) -> DiagnosisCase:
    """The last. loop_for : draws a loop in which a cause can occur."""
    cause = str(rng.choice(["ok", "ok", "aggressive", "sluggish"]))
    loop = loop_for(rng, cause)
    gains = settings(rng, loop, cause)
    count = int(rng.integers(1, 4))
    loop, n, first = record_length(rng, loop, gains, count)
    sp = event_steps(rng, n, first, count)
    lag = max(sum(loop.process.lags_s), loop.theta_s) / loop.dt_s
    places = [float(at) + lag * log_uniform(rng, 0.3, 3.0) for at in np.flatnonzero(np.diff(sp)) + 1]
    if places[-1] > 0.9 * n:
        raise NotClear
    sizes = (rng.choice([-1.0, 1.0], len(places)) * abs(1 / loop.process.k) * rng.uniform(0.2, 1.0)).tolist()
    if loop.process.integrators:
        sizes = [size / loop.theta_s for size in sizes]
    zero = np.zeros(n)
    record = scaled_record(rng, loop, gains, Plan(sp, steps(n, places, sizes), zero, log_uniform(rng, 0.003, 0.02)))
    return labelled(loop, gains, record, "load after step", {cause, "unknown"}, f"{cause}, a load after each step")
