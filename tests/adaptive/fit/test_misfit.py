"""The misfit: its Jacobian is the derivative, its nuisances explain what they stand for, structures nest."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.fit.dynamics import Dynamics
from retuner.adaptive.fit.misfit import Misfit, colour
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import bounds, pinned, refine
from retuner.adaptive.fit.search import long_lag, with_second_lag
from retuner.adaptive.fit.structure import LEAST_ZETA, SIZE, dynamics_at, model_at, parameters_of, swing_excess
from retuner.adaptive.identification.candidate import judged
from retuner.adaptive.identification.structure_choice import StructureSettings, candidates
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import Window

FIRST, SECOND, INTEGRATING = ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.INTEGRATING
NEAR = np.log([0.02, 5.0, 50.0])


def misfit(window: Window, type_: ProcessType = FIRST, **more: object) -> Misfit:
    record = Record.of(window)
    return replace(Misfit(record, type_, 1, 0, record.noise_std, 0.3), **more)


@pytest.mark.parametrize("ar", [(), (-0.6,)])
def test_the_jacobian_is_the_derivative_where_the_fit_is_good(loop: Callable, ar: tuple[float, ...]) -> None:
    """Kaufman's approximation leaves out a term that is proportional to the residual."""
    window = loop(sp=1.0, load=2.0, noise=1e-5).run(5)
    full = misfit(window, SECOND, loads=1, ar=ar, ramp=True)
    fit = refine(full, np.array([*np.log([0.02, 4.0, 51.0, 1.0]), 40.0]), enough=1e-12)
    jacobian = full.jacobian(fit.at)
    for j, h in enumerate((1e-5, 1e-5, 1e-5, 1e-5, 1e-3)):
        ahead, behind = fit.p.copy(), fit.p.copy()
        ahead[j], behind[j] = fit.p[j] + h, fit.p[j] - h
        numeric = (full.solve(ahead).r - full.solve(behind).r) / (2 * h)
        assert np.linalg.norm(jacobian[:, j] - numeric) < 0.02 * np.linalg.norm(numeric), j


def test_a_start_that_is_not_rest_is_taken_up(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.001).run(1)
    late = slice(90, None)
    cut = Window(*(getattr(window, n)[late] for n in ("t_s", "sp", "pv", "co")))
    at_rest, moving = misfit(cut, start_spread=0.0), misfit(cut)
    assert refine(moving, NEAR).deviance < 0.2 * refine(at_rest, NEAR).deviance
    truth = np.log([1 / 50, 5.0, 50.0])
    np.testing.assert_allclose(refine(moving, NEAR).x, truth, atol=0.1)


def test_a_ramp_takes_drift(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.003).run(2)
    drifting = replace(window, pv=window.pv + 0.3 * np.arange(len(window.t_s)) / len(window.t_s))
    with_ramp = refine(misfit(drifting, ramp=True), NEAR)
    assert judged(with_ramp).criterion < judged(refine(misfit(drifting), NEAR)).criterion - 20
    np.testing.assert_allclose(with_ramp.x, np.log([1 / 50, 5.0, 50.0]), atol=0.1)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("upset", [{"sp": 1.0}, {"load": 3.0}])
def test_bigger_structures_never_cost_more(loop: Callable, upset: dict[str, float], seed: int) -> None:
    loads = 1 if "load" in upset else 0
    window = loop(noise=0.02, n=300, theta=3.0 + seed, **upset).run(seed)
    start = np.array([*np.log([0.02, 5.0, 50.0]), *[40.0] * loads])
    first = refine(misfit(window, loads=loads), start)
    second = with_second_lag(first, SECOND, [])
    assert second.deviance <= first.deviance * 1.001
    integrating = refine(misfit(window, INTEGRATING, loads=loads), np.delete(start, 2))
    lagging = refine(misfit(window, FIRST, loads=loads), long_lag(integrating, FIRST))
    assert min(first.deviance, lagging.deviance) <= integrating.deviance * 1.001


def test_a_pinned_parameter_stays(loop: Callable) -> None:
    fit = refine(misfit(loop(sp=1.0, noise=0.01).run(3)), NEAR, pinned(3, 1, np.log(8.0), None))
    assert np.exp(fit.x[1]) == pytest.approx(8.0, rel=1e-3)


def test_parameters_stay_inside_their_bounds(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.5).run(4)
    for candidate in candidates(window, (1,), StructureSettings(seeded_loads=1, most_loads=1), 500):
        low, high = bounds(candidate.fit.misfit)
        assert np.all(candidate.fit.p >= low)
        assert np.all(candidate.fit.p <= high)


def test_gaps_get_a_state_of_their_own(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.002, n=600).run(5)
    kept = np.r_[0:120, 200:600]
    cut = Window(*(getattr(window, n)[kept] for n in ("t_s", "sp", "pv", "co")))
    record = Record.of(cut)
    assert record.gaps_s == (pytest.approx(100.0),)
    assert record.clock.dt_s is None
    np.testing.assert_allclose(refine(misfit(cut), NEAR).x, np.log([1 / 50, 5.0, 50.0]), atol=0.15)


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_the_colour_of_a_remainder(phi: float) -> None:
    rng = np.random.default_rng(6)
    e, r = rng.standard_normal(4000), np.zeros(4000)
    for i in range(1, 4000):
        r[i] = phi * r[i - 1] + e[i]
    found = colour(r, 1e-6)
    assert found.std == pytest.approx(1.0, abs=0.05)
    assert (found.ar[0] if found.ar else 0.0) == pytest.approx(-phi, abs=0.05)


# Parameters and models: there and back, for every structure, swinging processes among them.


LOGS = st.floats(-5, 5)


@given(type_=st.sampled_from(sorted(SIZE)), logs=st.lists(LOGS, min_size=5, max_size=5), sign=st.sampled_from([-1, 1]))
def test_there_and_back(type_: ProcessType, logs: list[float], sign: int) -> None:
    x = np.array(logs[: SIZE[type_]])
    np.testing.assert_allclose(parameters_of(model_at(type_, x, sign)), x, atol=1e-6)


def test_an_inverse_response_is_a_zero_in_the_right_half_plane() -> None:
    x = np.log([0.5, 1.0, 6.0, 1.5, 0.8])
    w = np.geomspace(1e-2, 1e2, 30)
    model = model_at(ProcessType.SOPDT_INVERSE, x, 1)
    plain = model_at(ProcessType.SOPDT, x[:4], 1).linear().response(w)
    np.testing.assert_allclose(model.linear().response(w), plain * (1 - 0.8j * w), rtol=1e-9)
    rise = dynamics_at(ProcessType.SOPDT_INVERSE, x).step(np.array([0.2, 60.0]))
    assert rise[0] < 0 < rise[1] == pytest.approx(6.0, rel=1e-3)


def test_a_third_lag_lies_behind_the_second_order() -> None:
    x = np.log([0.5, 1.0, 6.0, 4.0, 0.8])
    w = np.geomspace(1e-2, 1e2, 30)
    plain = model_at(ProcessType.SOPDT, x[:4], 1).linear().response(w)
    model = model_at(ProcessType.TOPDT, x, 1)
    assert model.zeta < 1
    np.testing.assert_allclose(model.linear().response(w), plain / (1 + 0.8j * w), rtol=1e-9)


@given(logs=st.lists(LOGS, min_size=4, max_size=4))
def test_model_and_dynamics_have_the_same_frequency_response(logs: list[float]) -> None:
    x = np.array(logs)
    w = np.geomspace(1e-3, 1e3, 30)
    s = 1j * w
    dynamics: Dynamics = dynamics_at(ProcessType.SOPDT, x)
    plain = np.exp(x[0] - np.exp(x[1]) * s) / (dynamics.c2_s * s**2 + s + dynamics.c0_per_s)
    np.testing.assert_allclose(model_at(ProcessType.SOPDT, x, 1).linear().response(w), plain, rtol=1e-6)


def test_the_wall_of_damping_begins_where_it_says() -> None:
    swings = ProcessModel(ProcessType.SOPDT, 1.0, 2.0, 2.0, 1.0, LEAST_ZETA * 1.001)
    rings = ProcessModel(ProcessType.SOPDT, 1.0, 2.0, 2.0, 1.0, LEAST_ZETA * 0.9)
    assert swing_excess(ProcessType.SOPDT, parameters_of(swings)) == 0
    assert swing_excess(ProcessType.SOPDT, parameters_of(rings)) == pytest.approx(-2 * np.log(0.9))


@pytest.mark.parametrize(
    ("model", "word"),
    [
        (ProcessModel(ProcessType.DELAY, 1.0, theta_s=1.0), "type delay"),
        (ProcessModel(ProcessType.FOPDT, 1.0, 1.0), "theta_s = 0"),
        (ProcessModel(ProcessType.SOPDT, 1.0, 1.0, 0.0, 1.0), "simpler type"),
    ],
)
def test_models_without_such_parameters_are_refused(model: ProcessModel, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        parameters_of(model)
