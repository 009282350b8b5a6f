"""Parameters and models: there and back, for every structure, swinging processes among them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.fit.dynamics import Dynamics
from retuner.adaptive.fit.structure import LEAST_ZETA, SIZE, dynamics_at, model_at, parameters_of, swing_excess
from retuner.adaptive.process.model import ProcessModel, ProcessType

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
