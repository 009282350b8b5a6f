"""Two upsets close together read as one oscillation: what the pattern rule was known to fall for."""

from itertools import product

import numpy as np
import pytest
from cases.plant import HeldPlant
from online.judge import perfect
from online.loop import WatchedLoop, one_region, settings
from online.rivals import batch

from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.response_finder import Completed, ResponseFinder
from retuner.adaptive.without_model.pattern_rule import MOVING, PatternAdvice, PatternSettings, pattern_rule
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable

PROCESSES = {m.name: m.process for m in batch() if m.name in {"P1 T=1", "P1 T=10", "P4 n=4", "P6 L=0.9"}}
SECOND, GAPS_THETA = (1.0, -1.0, 0.5, -0.5), (2.0, 4.0, 6.0, 10.0)


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


@pytest.fixture(scope="module")
def all_heard() -> list[PatternAdvice]:
    cases = product(PROCESSES, SECOND, GAPS_THETA)
    return [advice for case in cases for advice in heard(*case)]


@pytest.mark.slow
@pytest.mark.uncounted
def test_nearly_all_pairs_of_upsets_are_refused(all_heard: list[PatternAdvice]) -> None:
    assert len(all_heard) >= len(PROCESSES) * len(SECOND) * len(GAPS_THETA)
    fooled = [advice for advice in all_heard if advice.reading in MOVING]
    assert len(fooled) <= 0.15 * len(PROCESSES) * len(SECOND) * len(GAPS_THETA)
