"""Setpoint steps and the loads beside them in one likelihood: exact where theory gives the number."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_setpoint_steps import LAW, WALK, sequences

from retuner.adaptive.fit.structure import dynamics_at
from retuner.adaptive.identification import by_likelihood
from retuner.adaptive.identification.by_likelihood import TYPE, Likelihood, Likely, middle, runs_away, whitening
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.schedule.gains import PidGains

START = np.log([1 / 50, 5.0, 50.0, 1.0])  # slope gain, dead time, sum of the lags, second lag: near the bench's


def test_the_filter_leaves_of_its_own_process_what_was_never_foretold() -> None:
    """An autoregressive process of second order has two terms, and its innovations are what is left."""
    first, second, innovations = 1.5, -0.7, 0.25
    r = np.zeros(12)
    r[0] = innovations * (1 - second) / ((1 + second) * ((1 - second) ** 2 - first**2))  # Yule & Walker
    r[1] = first * r[0] / (1 - second)
    for k in range(2, 12):
        r[k] = first * r[k - 1] + second * r[k - 2]
    a, variance = whitening(r, 5)
    assert a == pytest.approx([1.0, -first, -second, 0.0, 0.0, 0.0], abs=1e-9)
    assert variance == pytest.approx(innovations)


@pytest.mark.parametrize(("kd", "filter_s"), [(0.0, 0.0), (3.0, 2.0)])
def test_process_and_controller_over_frequency_are_those_of_the_loop_in_time(kd: float, filter_s: float) -> None:
    law, n, dead_s = SampledLaw(PidGains(2.0, 0.05, kd), 1.0, 1.0, filter_s), 4096, 5.3
    p = np.array([math.log(0.02), math.log(dead_s), math.log(50.0), math.log(2.0)])
    held = math.exp(p[0]) * dynamics_at(TYPE, p).step(np.arange(n, dtype=np.float64) - dead_s)
    response = np.diff(setpoint_response(np.asarray(held), law), prepend=0.0)
    at = np.array([5, 100, 900])
    z1 = by_likelihood._z1()
    process, controller = by_likelihood._process(p, 1.0), by_likelihood._controller(law)
    from_sp = law.gains.kp + law.gains.ki * z1 / (1 - z1)
    seen = response @ z1[at] ** np.arange(n)[:, None]
    assert (process * from_sp / (1 + process * controller))[at] == pytest.approx(seen, abs=1e-6)


def likely(gains: float, walk: float, seed: int) -> Likely:
    own = sequences(2, walk, PidGains(gains, gains / 40, 0.0), seed=seed)
    found = Likelihood(own, 1, *LAW).best([START])
    assert found is not None
    return found


def test_of_a_loop_with_a_small_gain_the_loads_tell_the_process() -> None:
    """ln of the slope gain, where its controller hardly moves co, as surely as is claimed."""
    found = likely(0.6, WALK, seed=4)
    std = math.sqrt(found.own[0, 0])
    assert abs(found.p[0] - START[0]) <= 2.5 * std
    assert std < 0.5
    spread = math.exp(found.p[by_likelihood.LOAD]) / WALK
    assert 0.5 < spread < 2.0


def test_what_is_claimed_is_the_width_of_the_likelihood() -> None:
    own = sequences(2, WALK)
    likelihood = Likelihood(own, 1, *LAW)
    best = likelihood.best([START])
    assert best is not None
    at_one = [excess for _, excess in likelihood.around(best)][1 :: len(by_likelihood.AXES)]
    assert all(0.3 < excess < 2.5 for excess in at_one[:2])
    assert likelihood.around(best)[0][1] == 0.0


def test_the_middle_model_stands_for_ends_that_are_hardly_told_apart() -> None:
    ends = [(START + lag * np.eye(4)[2], 0.0) for lag in (-0.5, -0.2, 2.0)]
    assert middle(ends, 1, 1.0) == 1
    surely = [(x, 0.0 if i == 2 else 12.0) for i, (x, _) in enumerate(ends)]
    assert middle(surely, 1, 1.0) == 2


def test_a_loop_that_would_run_away_has_no_likelihood() -> None:
    (one,) = sequences(1, 0.01)
    likelihood = Likelihood([one], 1, *LAW)
    p = np.array([*START, math.log(WALK), math.log(0.1), 4.0])
    assert math.isfinite(likelihood.told(p).deviance)
    p[0] += math.log(30.0)
    assert math.isinf(likelihood.told(p).deviance)
    assert runs_away(np.array([0.0, 1.0, 0.0, 3.0]))
    assert not runs_away(np.array([0.0, 1.0, 1.2, 1.0]))


def test_what_no_record_tells_is_as_wide_as_of_any_process() -> None:
    """Of a loop at rest without a load nothing is told: the covariance stays finite, and so do the models in it."""
    (one,) = sequences(1, 0.0)
    quiet = replace(one, pv=tuple(0.001 * math.sin(i * i) for i in range(len(one.pv))))
    likelihood = Likelihood([quiet], 1, *LAW)
    p = np.array([-12.0, *START[1:], math.log(WALK), math.log(0.001), 4.0])
    curved = likelihood.curvature(p)
    own = np.linalg.inv(curved[1])[:4, :4]
    assert np.max(np.linalg.eigvalsh(own)) <= 1.0001 * by_likelihood.WIDEST**2
