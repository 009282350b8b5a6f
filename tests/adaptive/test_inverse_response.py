"""An inverse response and a lead are found as what they are, a zero of either side, and not as loads or a dead time."""

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete

from retuner import PidGains, ProcessModel, ProcessType, RetunerSettings
from retuner.adaptive.diagnosis import diagnose
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import linear
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.fit.search import with_one_more
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification import candidate
from retuner.adaptive.identification.candidate import judged
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc, robust_simc_on
from retuner.adaptive.indexes.screening import screen
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.signals.sample import Window
from retuner.schedule.late_dataclass import replace

INVERSE = ProcessType.SOPDT_INVERSE
K, LAGS, B, DELAY = 1.0, (12.0, 5.0), 5.0, 3  # Gain, lags and zero in seconds, dead time in samples of a second


def record(
    seed: int, *, sp: float = 0.0, load: float = 0.0, kc: float = 0.5, n: int = 400, zero: float = B,
    lags: tuple[float, float] = LAGS,
) -> Window:  # fmt: skip
    """PI on the process: a setpoint step and a load step after 40 s, 1 % noise."""
    rng = np.random.default_rng(seed)
    one, two = lags
    parts = np.array([[K * (1 + zero / one) / (one - two), -K * (1 + zero / two) / (one - two)]])
    a, b, c, _, _ = cont2discrete(
        (np.array([[-1 / lags[0], 0], [0, -1 / lags[1]]]), np.ones((2, 1)), parts, np.zeros((1, 1))), 1.0
    )
    x, integral = np.zeros(2), 0.0
    pv, co, wanted = np.zeros(n), np.zeros(n), np.where(np.arange(n) >= 40, sp, 0.0)
    for i in range(n):
        pv[i] = float((c @ x).item()) + 0.01 * rng.standard_normal()
        integral += kc / 17 * (wanted[i] - pv[i])
        co[i] = kc * (wanted[i] - pv[i]) + integral
        entered = (co[i - DELAY] if i >= DELAY else 0.0) + (load if i >= 40 else 0.0)
        x = a @ x + b[:, 0] * entered
    return Window(np.arange(float(n)), wanted, pv, co)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_setpoint_step_shows_the_zero_and_no_load_is_invented(seed: int) -> None:
    found = identify_window(record(seed, sp=1.0), sign=1)
    model = found.log.model()
    assert found.identifiable
    assert found.log.type == INVERSE
    assert found.load_times_s == ()
    assert model.k == pytest.approx(K, rel=0.05)
    assert model.inverse_s + model.theta_s == pytest.approx(B + DELAY, rel=0.15)
    assert model.inverse_s == pytest.approx(B, rel=0.3)


def test_beside_a_load_it_is_found_too() -> None:
    model = identify_window(record(4, load=1.0, n=600), sign=1).log.model()
    assert model.k == pytest.approx(K, rel=0.2)
    assert model.without_inverse().theta_s == pytest.approx(B + DELAY, rel=0.3)


def test_the_bigger_structure_is_never_the_worse_one() -> None:
    of = Record.of(record(5, sp=1.0))
    plain = ProcessModel(ProcessType.SOPDT, K, *LAGS, DELAY + B)
    smaller = Misfit(of, plain.type, 1, 0, of.noise_std, 0.3)
    fit = refine(smaller, parameters_of(plain))
    bigger = with_one_more(fit, INVERSE)
    assert bigger.deviance < fit.deviance - 30
    assert math.exp(bigger.x[-1]) == pytest.approx(B, rel=0.4)


LEAD, LONG = -16.0, (40.0, 6.0)
"""A lead: pv makes a jump of its own through a fast lag, and creeps on through a long one."""


@pytest.mark.parametrize("seed", [1, 2])
def test_a_lead_is_found_and_its_settings_hold(seed: int) -> None:
    found = identify_window(record(seed, sp=1.0, n=600, zero=LEAD, lags=LONG), sign=1)
    model = found.log.model()
    assert found.identifiable
    assert found.log.type == ProcessType.SOPDT_LEAD
    assert found.load_times_s == ()
    assert model.inverse_s == pytest.approx(LEAD, rel=0.3)
    assert model.k == pytest.approx(K, rel=0.05)
    truth = ProcessModel(ProcessType.SOPDT_LEAD, K, *LONG, DELAY + 0.5, inverse_s=LEAD)
    gains = robust_simc(found, 1.0, RobustSettings()).tuning.gains
    assert 1.4 < sensitivity_peak(truth.linear(), gains) < 1.8


def test_on_line_no_lead_is_looked_for() -> None:
    on_line, off_line = RetunerSettings(1.0, 1.0), DiagnosisSettings()
    own, compared, identified = (
        fit.choice for fit in (on_line.fit, on_line.diagnosis.fit, on_line.diagnosis.identified)
    )
    assert own.further == identified.further == (INVERSE, ProcessType.TOPDT)
    assert compared.further == ()
    assert off_line.fit.choice.further == (ProcessType.SOPDT_LEAD,)
    window = record(1, sp=1.0, n=600, zero=LEAD, lags=LONG)
    found = identify_window(window, sign=1, settings=on_line.fit)
    assert ProcessType.SOPDT_LEAD not in {one.log.type for one in found.alternatives}


def test_a_lead_is_no_sticking_valve_and_no_gain_that_changes() -> None:
    kc, tau_i = 0.5, 17.0
    found = diagnose_window(record(2, sp=1.0, n=600, zero=LEAD, lags=LONG), PidGains(kc, kc / tau_i))
    assert found.estimate.log.type == ProcessType.SOPDT_LEAD
    assert found.diagnosis.cause in {Cause.OK, Cause.SLUGGISH}


@pytest.mark.parametrize(("long", "lead"), [(6e4, 16.0), (6e4, 3e4), (40.0, 5e3)])
def test_a_lead_beside_a_lag_without_end_has_settings_that_hold(long: float, lead: float) -> None:
    process = ProcessModel(ProcessType.SOPDT_LEAD, 9e3, long, 10.0, 11.0, inverse_s=-lead)
    gains = robust_simc_on(process, (), 1.0, RobustSettings()).tuning.gains
    assert 1.2 < sensitivity_peak(process.seen_by_controller(1.0).linear(), gains) < 1.75


class AskedError(Exception):
    """With the structure beside which a tone and a valve were asked."""


@pytest.mark.parametrize("period_s", [None, 50.0])
def test_of_a_record_that_oscillates_no_lead_is_asked(period_s: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(best: candidate.Candidate, *_: object) -> None:
        raise AskedError(best.fit.misfit.type)

    window = record(2, sp=1.0, n=600, zero=LEAD, lags=LONG)
    settings = DiagnosisSettings(oscillating_residual=0.1)
    found = linear(window, (1,), settings.fit.choice, 2000)
    seen = replace(screen(window), period_s=period_s)
    monkeypatch.setattr(diagnose, "stiction_or_tone", asked)
    with pytest.raises(AskedError) as told:
        diagnose._loop_or_tone_or_valve(window, None, found, seen, settings, diagnose.unknown_law)
    assert (told.value.args[0] == ProcessType.SOPDT_LEAD) == (period_s is None)


def test_a_lead_pays_for_being_rare(monkeypatch: pytest.MonkeyPatch) -> None:
    of = Record.of(record(5, sp=1.0, zero=LEAD, lags=LONG))
    x = parameters_of(ProcessModel(ProcessType.SOPDT_LEAD, K, *LONG, DELAY, inverse_s=LEAD))
    fit = refine(Misfit(of, ProcessType.SOPDT_LEAD, 1, 0, of.noise_std, 0.3), x)
    paid = judged(fit).criterion
    monkeypatch.setattr(candidate, "RARE", {})
    assert paid - judged(fit).criterion == pytest.approx(2 * math.log(20))


def test_what_leads_has_real_poles() -> None:
    of = Record.of(record(5, sp=1.0, zero=LEAD, lags=LONG))
    rings = parameters_of(ProcessModel(ProcessType.SOPDT_LEAD, K, 10.0, 10.0, DELAY, 0.3, LEAD))
    fit = refine(Misfit(of, ProcessType.SOPDT_LEAD, 1, 0, of.noise_std, 0.3), rings)
    assert fit.x[3] < fit.x[2] - math.log(4) + 0.1
