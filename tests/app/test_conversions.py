"""Models and gains from and to scipy.signal and python-control: the same frequency response, and what is refused."""

import subprocess
import sys

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from retuner import gains_of, process_of, reduce, to_control, to_scipy
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.process.transfer_functions import from_roots, pade
from retuner.schedule.gains import PidGains

W = np.geomspace(1e-3, 1e2, 60)
E2 = LinearProcess(1.0, (2.0, 1.0, 0.4, 0.2, 0.05, 0.05, 0.05), (-0.3, 0.08))
E6 = LinearProcess(1.0, (1.0, 1.0, 0.028), (0.17, 0.17), 0.0, 1)
SWINGING = LinearProcess(-3.0, (4.0,), (0.5,), 0.0, 0, ((1.2, 1.0),))


@pytest.mark.parametrize("process", [E2, E6, SWINGING, LinearProcess(2.0), LinearProcess(0.1, (), (), 0.0, 2)])
@pytest.mark.parametrize("to", [to_scipy, to_control])
def test_there_and_back_is_the_same_process(process: LinearProcess, to: object) -> None:
    assert callable(to)
    system = to(process)
    value = scipy.signal.freqs(system.num, system.den, W)[1] if to is to_scipy else system(1j * W)
    assert np.allclose(value, process.response(W), rtol=1e-9)
    assert np.allclose(process_of(system).response(W), process.response(W), rtol=1e-6)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("process", [E2, E6, LinearProcess(1.0, (1.0,) * 4)])
def test_a_reduction_from_a_polynomial_is_that_from_its_time_constants(process: LinearProcess, order: int) -> None:
    direct = reduce(process, order).model
    for system in (to_scipy(process), to_control(process), control.ss(to_control(process))):
        model = reduce(process_of(system), order).model
        assert model.type == direct.type
        assert (model.k, model.tau1_s, model.tau2_s, model.theta_s) == pytest.approx(
            (direct.k, direct.tau1_s, direct.tau2_s, direct.theta_s), abs=2e-3
        )


def test_scipy_zeros_poles_gain_and_state_space_are_read() -> None:
    zpk = scipy.signal.ZerosPolesGain([], [-0.5, -2.0], 3.0)
    found = process_of(zpk, theta_s=1.5)
    assert (found.k, *sorted(found.lags_s), found.theta_s) == pytest.approx((3.0, 0.5, 2.0, 1.5))
    assert np.allclose(process_of(zpk.to_ss(), 1.5).response(W), found.response(W))


@given(st.lists(st.floats(0.05, 20.0), min_size=1, max_size=4), st.floats(-5.0, 5.0).filter(lambda x: abs(x) > 0.1))
def test_polynomials_of_any_lags_are_read_back(lags: list[float], k: float) -> None:
    process = LinearProcess(k, tuple(lags))
    system = to_scipy(process)
    read = from_roots(np.roots(system.num), np.roots(system.den), system.num[0] / system.den[0])
    assert np.allclose(read.response(W), process.response(W), rtol=1e-5)


def test_pade_is_a_dead_time_up_to_its_band() -> None:
    num, den = pade(2.0, 5)
    w = np.linspace(0.01, 2.5, 50)
    assert np.allclose(np.polyval(num, 1j * w) / np.polyval(den, 1j * w), np.exp(-2j * w), atol=4e-3)
    model = ProcessModel(ProcessType.FOPDT, 2.0, 10.0, 0.0, 2.0)
    assert np.allclose(to_control(model)(1j * w), model.linear().response(w), atol=4e-3)


@pytest.mark.parametrize(
    "gains", [PidGains(2.0, 0.5), PidGains(2.0, 0.5, 1.5), PidGains(-1.0, 0.0), PidGains(0.0, 0.3)]
)
def test_gains_there_and_back(gains: PidGains) -> None:
    assert gains_of(to_control(gains)) == gains
    if gains.ki:
        assert gains_of(to_scipy(gains)) == gains


REFUSED = {
    "an unstable pole": (control.tf([1], [1, -1]), "unstable"),
    "a differentiator": (control.tf([1, 0], [1, 1]), "zero at the origin"),
    "complex zeros": (control.tf([1, 0.2, 1], [1, 3, 3, 1]), "complex zeros"),
    "a discrete system": (control.tf([1], [1, -0.5], 0.1), "sampled"),
    "a discrete scipy system": (scipy.signal.TransferFunction([1], [1, -0.5], dt=0.1), "sampled"),
    "two inputs": (control.ss([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]]), "2 inputs"),
    "nothing": (control.tf([0], [1, 1]), "k = "),
}


@pytest.mark.parametrize("case", REFUSED)
def test_systems_that_no_model_stands_for_are_refused(case: str) -> None:
    system, words = REFUSED[case]
    with pytest.raises(ValueError, match=words):
        process_of(system)


def test_what_is_no_system_is_refused() -> None:
    with pytest.raises(TypeError, match="neither"):
        process_of([1, 2])
    with pytest.raises(TypeError, match="neither"):
        gains_of(3.0)
    with pytest.raises(ValueError, match="not kp"):
        gains_of(control.tf([1], [1, 1]))
    with pytest.raises(ValueError, match="pade_order"):
        to_control(ProcessModel(ProcessType.DELAY, 1.0, theta_s=1.0), 0)


def test_neither_package_is_imported_before_it_is_asked_for() -> None:
    code = (
        "import sys, retuner; retuner.reduce; retuner.to_control; "
        "assert not {'control', 'scipy.signal'} & set(sys.modules), 'imported'"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True)
