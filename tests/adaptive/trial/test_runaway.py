"""The watch over a trial: what runs away is stopped in mid-response, and nothing else is."""

import numpy as np
import pytest
from rig import BAD, GOOD, MODEL, PROMISE, Rig

from retuner import LoopSample, TrialEvent
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.trial.diverging_trial import DivergenceLimits, divergence_begin, divergence_step, law_of
from retuner.adaptive.trial.prediction import predict
from retuner.adaptive.trial.trial_settings import TrialSettings

S = TrialSettings()
LAW = law_of(PROMISE, S, 60.0)


def run(
    rig: Rig, samples: int, law: DivergenceLimits = LAW, band: float = 0.1
) -> tuple[TrialEvent | None, float, float]:
    """What the watch says, when, and the largest error until then."""
    state, start, peak = divergence_begin(rig.sp), rig.t_s, 0.0
    for sample in rig.run(samples):
        peak = max(peak, abs(sample.sp - sample.pv))
        state, found = divergence_step(law, state, sample, band)
        if found:
            return found, sample.t_s - start, peak
    return None, samples, peak


@pytest.mark.parametrize("upset", [{"sp": 5.0}, {"load": 10.0}], ids=str)
def test_an_unstable_set_is_stopped_in_its_third_half_wave(upset: dict[str, float]) -> None:
    free = Rig(BAD["kc x4"], noise=0.02)
    for name, value in upset.items():
        setattr(free, name, value)
    unwatched = max(abs(s.sp - s.pv) for s in free.run(100))
    rig = Rig(BAD["kc x4"], noise=0.02, **upset)
    found, after_s, peak = run(rig, 400)
    assert found is TrialEvent.RUNAWAY
    assert after_s < 60
    assert peak < unwatched / 5


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("upset", [{}, {"sp": 5.0}, {"load": 10.0}], ids=str)
def test_good_gains_are_left_alone_for_long(seed: int, upset: dict[str, float]) -> None:
    assert run(Rig(GOOD, noise=0.03, seed=seed, **upset), 1500)[0] is None


def said(errors: list[float], band: float = 0.1) -> TrialEvent | None:
    state = divergence_begin(0.0)
    for i, e in enumerate(errors):
        state, found = divergence_step(LAW, state, LoopSample(float(i), 0.0, -e, 0.0), band)
        if found:
            return found
    return None


def test_a_half_wave_that_was_under_way_is_no_measure() -> None:
    """The trial begins on a falling edge; a slow tail and a load follow: two larger ones, and no swing."""
    tail, load = [-2.0, -1.9, -1.8, -1.7], [0.5, 2.0, 3.0, 2.0]
    assert said([1.0, 0.6, 0.3, *tail, *load]) is None
    assert said([0.0, 1.0, 0.6, 0.3, *tail, *load]) is TrialEvent.RUNAWAY  # seen from the start, it grows
    assert said([1.0, 0.6, *tail, *load, -4.5]) is TrialEvent.RUNAWAY
    assert said([1.0, 0.0, 0.0, 0.0, 1.0, *tail, *load]) is TrialEvent.RUNAWAY  # the first one came to rest


def test_a_swing_that_does_not_die_out_is_stopped_and_one_that_decays_is_not() -> None:
    def swing(decay: float) -> TrialEvent | None:
        return said([5.0 * decay**i * (-1) ** i * share for i in range(12) for share in (0.5, 1.0, 0.5)])

    assert swing(1.0) is TrialEvent.RUNAWAY
    assert swing(0.97) is TrialEvent.RUNAWAY
    assert swing(0.9) is None
    assert swing(0.5) is None


def test_loads_that_come_now_and_then_and_grow_are_no_swing() -> None:
    rig = Rig(GOOD)
    state, found = divergence_begin(0.0), None
    for load in (5.0, 15.0, 40.0, 100.0):
        rig.load = load
        for sample in rig.run(120):
            state, found = divergence_step(LAW, state, sample, 0.1)
            assert found is None


@pytest.mark.parametrize(("rest", "found"), [(12, None), (3, TrialEvent.RUNAWAY)])
def test_what_comes_after_a_rest_is_another_upset(rest: int, found: TrialEvent | None) -> None:
    """Two half waves of five samples, a longer or a shorter rest, a load."""
    assert said([0.0] + [0.5] * 5 + [-0.6] * 5 + [0.0] * rest + [3.0] * 5) is found


def test_a_new_setpoint_begins_anew() -> None:
    rig, state = Rig(GOOD), divergence_begin(0.0)
    for size in (5.0, -10.0, 20.0, -40.0, 80.0):
        rig.sp = size
        for sample in rig.run(150):
            state, found = divergence_step(LAW, state, sample, 0.1)
            assert found is None
    assert state.sp == 80.0


def test_an_output_between_its_limits_is_stopped_and_one_that_stays_at_a_limit_too() -> None:
    def limits(pattern: list[int]) -> TrialEvent | None:
        state = divergence_begin(0.0)
        for i, limit in enumerate(pattern):
            state, found = divergence_step(LAW, state, LoopSample(float(i), 0.0, 0.0, 0.0, limited=limit), 0.1)
            if found:
                return found
        return None

    assert limits([1, 0, -1, 0, 1, 0, -1]) is TrialEvent.RUNAWAY
    assert limits([1, 0, -1, 0, -1, 0, -1]) is None
    long = int(LAW.limited_s) + 2
    assert limits([1] * long) is TrialEvent.SATURATED
    assert limits(([1] * (long - 3) + [0]) * 3) is None


def test_a_loop_that_was_unstable_before_may_grow_as_it_did() -> None:
    worse = predict([Plausible(MODEL, 0.0)], BAD["kc x4"], GOOD, 1.0)
    assert law_of(worse, S, 60.0).grows > LAW.grows == S.grows


@pytest.mark.parametrize("moves", [0.15, 0.5])
def test_a_setpoint_that_moves_at_every_sample_does_not_blind_the_watch(moves: float) -> None:
    rig = Rig(BAD["kc x4"], noise=0.02, load=10.0, limit=50.0)
    state, found = divergence_begin(rig.sp), None
    for number in range(300):
        rig.sp = moves * (number % 2)
        (sample,) = rig.run(1)
        state, found = divergence_step(LAW, state, sample, 0.1)
        if found:
            break
    assert found is TrialEvent.RUNAWAY
    assert sample.t_s < 100


@pytest.mark.parametrize("steps", [0.3, 1.0, 5.0])
def test_a_setpoint_that_moves_is_no_runaway_of_calm_gains(steps: float) -> None:
    rig = Rig(GOOD, noise=0.02)
    state = divergence_begin(rig.sp)
    moves = np.random.default_rng(7).choice([-steps, 0.0, 0.0, steps], size=400)
    for number in range(4000):
        if number % 10 == 0:
            rig.sp += float(moves[number // 10])
        (sample,) = rig.run(1)
        state, found = divergence_step(LAW, state, sample, 0.1)
        assert found is None


def watched(waves: list[tuple[float, int]]) -> TrialEvent | None:
    """Half waves of four samples, by extreme and by the limit at which the output stands in them."""
    state, t_s = divergence_begin(0.0, joined=False), 0.0
    for extreme, limited in waves:
        for e in (0.5 * extreme, extreme, 0.8 * extreme, 0.4 * extreme):
            t_s += 1.0
            state, found = divergence_step(LAW, state, LoopSample(t_s, 0.0, -e, 0.0, limited=limited), 0.1)
            if found:
                return found
    return None


def test_half_waves_of_an_output_at_its_limit_are_no_growth() -> None:
    """A load that is beyond the output's range: pv runs off as far as the load goes, whatever the gains are."""
    pushed = [(1.0, 0), (-1.5, 1), (2.5, 0), (-1.0, 0), (0.4, 0)]
    assert watched([(extreme, 0) for extreme, _ in pushed]) is TrialEvent.RUNAWAY
    assert watched(pushed) is None
    assert watched([(1.0, 0), (-1.5, 1), (2.0, 0), (-3.0, 0), (4.0, 0)]) is TrialEvent.RUNAWAY, "free ones still count"
    one_sided = [(2.0 * (-1) ** i, i % 2) for i in range(2 * S.stays_for + 4)]
    assert watched(one_sided) is TrialEvent.RUNAWAY, "a lasting swing against one limit"
