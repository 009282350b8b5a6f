"""The pattern rule as a whole tuner, by itself, on processes of the batch: near its targets, and then at rest; and what
it was known to fall for: two upsets close together read as one oscillation.
"""

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
import pytest
from cases.plant import HeldPlant
from online.judge import perfect
from online.loop import LostLoop, WatchedLoop, one_region, settings
from online.rivals import PatternAlone, batch

from retuner import GainTable, LinearProcess, LoopSample, PidGains
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.supervision.response_finder import Completed, ResponseFinder
from retuner.adaptive.without_model.pattern_rule import MOVING, PatternAdvice, PatternSettings, pattern_rule

PROCESSES = {
    m.name: m.process
    for m in batch()
    if m.name in {"P1 T=1", "P1 T=10", "P2 T=0.5", "P4 n=4", "P5 a=0.5", "P6 L=0.9", "P7 T=2 L=0.3", "P9 T=0.5"}
}
UPSETS, LENGTH_THETA, NOISE = 14, 80, 0.01


class Story(NamedTuple):
    """Gains after each change, the first those at the start; settled: changes by the last four upsets; best: SIMC's."""

    gains: list[PidGains]
    late: int
    best: PidGains
    sampled: LinearProcess
    lost: bool

    def ms(self) -> list[float]:
        return [sensitivity_peak(self.sampled, gains) for gains in self.gains]


class Noted(PatternAlone):
    """Keeps the times of its changes."""

    def observe(self, sample: LoopSample) -> tuple[int, PidGains] | None:
        wish = super().observe(sample)
        if wish is not None:
            self.changes.append((sample.t_s, wish[1]))
        return wish


@cache
def story(name: str, start: tuple[float, float]) -> Story:
    """Setpoint and load steps in turn, from gains off by factors on Kc and tau_I."""
    process = PROCESSES[name]
    dt_s = perfect(process, 0.0)[1] / 8
    best, theta_s = perfect(process, dt_s)
    first = PidGains(best.kp * start[0], best.ki * start[0] / start[1])
    rule = Noted(one_region(first), settings(dt_s, 10.0))
    rule.changes = []
    loop = WatchedLoop(HeldPlant(process, dt_s), rule.table, dt_s, rule)
    rng, sp, load, lost = np.random.default_rng(3), 0.0, 0.0, False
    size = 0.5 * abs(best.kp)
    n = int(max(LENGTH_THETA * theta_s, 6 * best.kp / best.ki) / dt_s)
    try:
        loop.run(0.0, 0.0, list(NOISE * rng.standard_normal(60)))
        for i in range(UPSETS):
            sp, load = (1.0 - sp, load) if i % 2 == 0 else (sp, size - load)
            loop.run(sp, load, list(NOISE * rng.standard_normal(min(n, 5000))))
    except LostLoop:
        lost = True
    late = sum(t_s > loop.t_s - 4 * n * dt_s for t_s, _ in rule.changes)
    sampled = replace(process, theta_s=process.theta_s + dt_s / 2)
    return Story([first, *(gains for _, gains in rule.changes)], late, best, sampled, lost)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROCESSES)
@pytest.mark.parametrize("start", [(4.0, 1.0), (0.25, 1.0), (1.0, 4.0), (1.0, 0.25)], ids=str)
def test_from_gains_far_off_to_calm_ones_and_no_loop_is_made_unstable(name: str, start: tuple[float, float]) -> None:
    told = story(name, start)
    ms = told.ms()
    assert not told.lost
    assert all(math.isfinite(after) for before, after in pairwise(ms) if math.isfinite(before))
    assert ms[-1] <= 3.2
    assert max(ms[-4:]) <= max(3.7, ms[0])
    if math.isinf(ms[0]) or ms[0] > 3.0:
        assert ms[-1] < ms[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", PROCESSES)
def test_a_loop_that_is_right_keeps_its_neighbourhood(name: str) -> None:
    told = story(name, (1.0, 1.0))
    assert told.ms()[-1] <= 2.3
    least = 0.3 if PROCESSES[name].integrators else 0.5  # an integrating loop overshoots a setpoint by itself
    assert least <= told.gains[-1].kp / told.best.kp <= 2.5
    assert told.late <= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PROCESSES if name != "P6 L=0.9"])
def test_a_sluggish_loop_rejects_loads_faster_in_the_end(name: str) -> None:
    told = story(name, (0.25, 1.0))
    assert told.gains[-1].ki > 1.5 * told.gains[0].ki


class Listening:
    """Hears every response, and changes nothing."""

    def __init__(self, table: GainTable, dt_s: float) -> None:
        self.table, self.gains = table, table.gains_of(0)
        self.finder = ResponseFinder(table.regions, table.at, settings(dt_s, 10.0))
        self.heard: list[PatternAdvice] = []

    def observe(self, sample: LoopSample) -> None:
        seen = self.finder.step(sample)
        if isinstance(seen, Completed):
            window = self.finder.window(seen.response)
            self.heard.append(pattern_rule(seen.response, window, self.gains, None, PatternSettings()))

    def written(self, region: int, gains: PidGains) -> None:
        raise AssertionError(f"nothing was asked for: {region} {gains}")


def heard(name: str, second: float, gap_theta: float) -> list[PatternAdvice]:
    """Under SIMC's gains, a load pulse one dead time long, and another one after the gap."""
    process = PROCESSES[name]
    dt_s = perfect(process, 0.0)[1] / 8
    best = perfect(process, dt_s)[0]
    listening = Listening(one_region(best), dt_s)
    loop = WatchedLoop(HeldPlant(process, dt_s), listening.table, dt_s, listening)
    rng, size = np.random.default_rng(1), 3.0 * best.kp
    for load, n in ((0.0, 400), (size, 8), (0.0, int(8 * (gap_theta - 1))), (second * size, 8), (0.0, 1200)):
        loop.run(0.0, load, list(0.01 * rng.standard_normal(n)))
    return listening.heard


@pytest.mark.slow
@pytest.mark.uncounted
def test_nearly_all_pairs_of_upsets_are_refused() -> None:
    """Behind two lags at most, four, and a long dead time; the second upset as large as the first or half of it."""
    cases = list(product(("P1 T=1", "P1 T=10", "P4 n=4", "P6 L=0.9"), (1.0, -1.0, 0.5, -0.5), (2.0, 4.0, 6.0, 10.0)))
    all_heard = [advice for case in cases for advice in heard(*case)]
    assert len(all_heard) >= len(cases)
    assert sum(advice.reading in MOVING for advice in all_heard) <= 0.15 * len(cases)
