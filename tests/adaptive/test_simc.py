"""SIMC against the table and examples of Skogestad (2003), and dimensional analysis."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import ControllerKind, simc, without_second_lag

T = ProcessType
EXAMPLES = [  # Skogestad (2003), examples at tau_c = theta: model, kind, Kc, tau_I, tau_D as printed
    ("E1", ProcessModel(T.FOPDT, 1, 1.1, 0, 0.1), "pi", 5.5, 0.8, 0.0),
    ("E2 PI", ProcessModel(T.FOPDT, 1, 2.5, 0, 1.47), "pi", 0.8503, 2.5, 0.0),
    ("E2 PID", ProcessModel(T.SOPDT, 1, 2, 1.2, 0.77), "pid", 1.299, 2, 1.2),
    ("E3 PI", ProcessModel(T.FOPDT, 1.5, 1.05, 0, 0.15), "pi", 2.333, 1.05, 0.0),
    ("E3 PID", ProcessModel(T.SOPDT, 1.5, 1, 0.15, 0.05), "pid", 6.667, 0.4, 0.15),
    ("E4 PI", ProcessModel(T.FOPDT, 1, 1.5, 0, 2.5), "pi", 0.3, 1.5, 0.0),
    ("E6 PI", ProcessModel(T.INTEGRATING, 1, 0, 0, 1.69), "pi", 0.2959, 13.52, 0.0),
    ("E6 PID", ProcessModel(T.INTEGRATING_LAG, 1, 0, 1.33, 0.358), "pid", 1.397, 2.864, 1.33),
]


@pytest.mark.parametrize(
    ("model", "kind", "kc", "tau_i", "tau_d"), [e[1:] for e in EXAMPLES], ids=[e[0] for e in EXAMPLES]
)
def test_published_settings(model: ProcessModel, kind: str, kc: float, tau_i: float, tau_d: float) -> None:
    gains = simc(model, kind=ControllerKind(kind)).to_dict()["gains"]
    assert isinstance(gains, dict)
    assert gains["kc"] == pytest.approx(kc, rel=5e-4)
    assert gains["tau_i"] == pytest.approx(tau_i, rel=2e-4)
    assert gains["tau_d"] == pytest.approx(tau_d, rel=2e-4, abs=1e-12)


def test_pure_delay_gives_an_integral_controller() -> None:
    tuning = simc(ProcessModel(T.DELAY, 2.0, theta_s=3.0))
    assert tuning.gains.kp == 0
    assert tuning.gains.ki == pytest.approx(1 / (2.0 * 6.0))
    assert tuning.to_dict()["gains"] == {"kc": 0.0, "tau_i": None, "tau_d": 0.0}


def test_double_integrator() -> None:
    tuning = simc(ProcessModel(T.DOUBLE_INTEGRATING, 0.5, theta_s=2.0), kind=ControllerKind.PID)
    gains = tuning.to_dict()["gains"]
    assert isinstance(gains, dict)
    assert gains["kc"] == pytest.approx(1 / (4 * 0.5 * 16))
    assert gains["tau_i"] == pytest.approx(16)
    assert gains["tau_d"] == pytest.approx(16)


def test_without_dead_time_tau_c_must_be_given() -> None:
    model = ProcessModel(T.FOPDT, 1, 5)
    with pytest.raises(ValueError, match="give tau_c"):
        simc(model)
    assert simc(model, 1.0).gains.kp == pytest.approx(5.0)


@pytest.mark.parametrize("tau_c", [0.0, -2.0, math.nan, math.inf])
def test_impossible_tau_c_is_refused(tau_c: float) -> None:
    with pytest.raises(ValueError, match="tau_c"):
        simc(ProcessModel(T.FOPDT, 1, 5), tau_c)


models = st.builds(
    lambda k, tau1, share, theta: ProcessModel(T.SOPDT, k, tau1, tau1 * share, theta),
    st.floats(1e-3, 1e3),
    st.floats(0.1, 100),
    st.floats(0.01, 1),
    st.floats(0.05, 50),
)


@given(model=models, a=st.floats(1e-3, 1e3), g=st.floats(1e-3, 1e3), kind=st.sampled_from(list(ControllerKind)))
def test_time_and_gain_scale_as_dimensions_demand(
    model: ProcessModel, a: float, g: float, kind: ControllerKind
) -> None:
    scaled = ProcessModel(T.SOPDT, model.k * g, model.tau1_s * a, model.tau2_s * a, model.theta_s * a)
    base, other = simc(model, kind=kind).gains, simc(scaled, kind=kind).gains
    assert other.kp * g == pytest.approx(base.kp, rel=1e-9)
    assert other.ki * g * a == pytest.approx(base.ki, rel=1e-9)
    assert other.kd * g / a == pytest.approx(base.kd, rel=1e-9)


@given(model=models, kind=st.sampled_from(list(ControllerKind)))
def test_reverse_action_mirrors(model: ProcessModel, kind: ControllerKind) -> None:
    mirrored = ProcessModel(model.type, -model.k, model.tau1_s, model.tau2_s, model.theta_s)
    base, other = simc(model, kind=kind).gains, simc(mirrored, kind=kind).gains
    assert (other.kp, other.ki, other.kd) == (-base.kp, -base.ki, -base.kd)


def test_half_rule_for_pi() -> None:
    assert without_second_lag(ProcessModel(T.SOPDT, 1, 1.0, 0.2, 0.0)) == ProcessModel(T.FOPDT, 1, 1.1, 0, 0.1)


def test_an_inverse_response_counts_as_dead_time() -> None:
    inverse = ProcessModel(T.SOPDT_INVERSE, 2.0, 10.0, 3.0, 1.0, inverse_s=1.5)
    plain = ProcessModel(T.SOPDT, 2.0, 10.0, 3.0, 2.5)
    assert without_second_lag(inverse) == without_second_lag(plain)
    for kind in (ControllerKind.PI, ControllerKind.PID):
        assert simc(inverse, kind=kind).gains == simc(plain, kind=kind).gains
