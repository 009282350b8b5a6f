"""Setpoint steps to and fro: they are found in the samples, and judged once and together."""

import numpy as np
import pytest
from loop_bench import Bench, made, scaled

from retuner import Decision, LoopSample
from retuner.adaptive.signals.step_sequence import WHOLE_STEPS, step_sequence

HOLD, SIZE, REST = 150, 0.5, 200
LEVELS = (SIZE, -SIZE, SIZE, -SIZE, SIZE)


def walk(size: float, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return size * np.cumsum(rng.standard_normal(REST + HOLD * (len(LEVELS) + 1)))


def stepped(bench: Bench, levels: tuple[float, ...] = LEVELS, load: float = 0.0) -> list[LoopSample]:
    """Samples of a loop whose setpoint goes through the levels and back to 0, with a load that walks."""
    loads = iter(walk(load))
    seen = []
    for sp, n in ((0.0, REST), *((level, HOLD) for level in levels), (0.0, HOLD)):
        for _ in range(n):
            seen += list(bench.samples(1, sp, float(next(loads)), 10.0))
    return seen


def quiet(load: float = 0.0, noise: float = 0.0) -> list[LoopSample]:
    bench = made(scaled(0.5, 0.5))
    bench.noise = noise
    return stepped(bench, load=load)


def test_the_steps_are_found_with_their_ends() -> None:
    found = step_sequence(quiet())
    assert (found.base, found.opened, found.closed) == (0.0, REST, REST + HOLD * len(LEVELS))
    assert found.whole == tuple(REST + HOLD * i for i in range(1, WHOLE_STEPS + 1))


@pytest.mark.parametrize("levels", [(0.5,), (0.5, 0.0, -0.5), (0.5, -0.5, 0.4, -0.5, 0.5), (0.5, -0.5, 1.0)])
def test_other_moves_are_no_steps_to_and_fro(levels: tuple[float, ...]) -> None:
    samples = stepped(made(scaled(1.0, 1.0)), levels)
    assert step_sequence(samples[: REST + HOLD * len(levels) - 5]) is None


def test_steps_at_uneven_times_are_as_good() -> None:
    samples = quiet()
    found = step_sequence(samples[: REST + HOLD + 30] + samples[REST + 2 * HOLD :])
    assert len(found.whole) == WHOLE_STEPS


def test_steps_that_never_come_back_are_none_in_the_end() -> None:
    samples = stepped(made(scaled(1.0, 1.0)), LEVELS)
    samples = [s._replace(sp=SIZE) if i >= REST + HOLD * len(LEVELS) else s for i, s in enumerate(samples)]
    assert step_sequence(samples[: REST + HOLD * len(LEVELS) + 5]) is not None
    assert step_sequence(samples) is None


def test_steps_under_other_gains_belong_to_another_loop() -> None:
    samples = quiet()
    changed = [s._replace(revision=int(i > REST + 2 * HOLD + 20)) for i, s in enumerate(samples)]
    found = step_sequence(changed)
    assert found is None or len(found.whole) < WHOLE_STEPS


def decided(load: float) -> list[Decision]:
    bench = made(scaled(0.3, 0.3))
    found = [bench.retuner.observe(sample) for sample in stepped(bench, load=load)]
    return [decision for decision in found if decision is not None]


def test_a_person_may_set_back_by_twice_what_he_had_set() -> None:
    bench = made(scaled(0.5, 0.5))
    large = 0.2 * bench.retuner.settings.pv_span
    found = [bench.retuner.observe(sample) for sample in stepped(bench, (large, -large))]
    judged = [decision for decision in found if decision is not None]
    assert len(judged) >= 2
    assert not [decision.reason for decision in judged if "to and fro" in decision.reason]


def test_under_a_load_that_walks_they_are_judged_once_and_together() -> None:
    decisions = [d for d in decided(0.03) if d.t_s > REST]  # what the load did before them stands by itself
    assert [d.reason for d in decisions if d.records] == [d.reason for d in decisions if "joined:" in d.reason]
    (whole,) = [d for d in decisions if "6 setpoint steps to and fro, joined: " in d.reason]
    model = whole.known.model()
    assert model.k / model.tau1_s == pytest.approx(1 / 50, rel=0.3)


@pytest.mark.slow
def test_steps_on_their_way_are_told_twice_at_most() -> None:
    parts = [d for d in decided(0.03) if "one of several setpoint steps to and fro" in d.reason]
    assert 1 <= len(parts) <= 2
