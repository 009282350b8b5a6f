"""The slow-oscillation rule on responses: exact on integrating loops, silent on everything else."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.guard.request import Locks
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.without_model.proposal_without_model import (
    SlowAdvice,
    SlowReading,
    SlowSettings,
    slow_oscillation_online,
    zeta_of,
)
from retuner.schedule.gains import PidGains

SETTINGS = SlowSettings()


def swing(zeta: float, w0: float = 1.0, *, setpoint: bool = False, size: float = 1.0) -> Response:
    """Exact peaks of PI on k'/s: tau_I = 2 zeta/w0, k' Kc = 2 zeta w0.

    Error after a load ~ exp(-a t) sin(w t); after a setpoint step exp(-a t)(cos w t - a/w sin w t), which begins at 1.
    """
    a, w = zeta * w0, w0 * math.sqrt(1 - zeta**2)
    first = math.atan2(w, a) / w if not setpoint else math.atan2(2 * a * w, a * a - w * w) % math.pi / w
    times = [first + i * math.pi / w for i in range(3)]

    def error(t: float) -> float:
        wave = math.cos(w * t) - a / w * math.sin(w * t) if setpoint else math.sin(w * t)
        return size * math.exp(-a * t) * wave

    if setpoint:
        times = [0.0, *times[:2]]
    return Response(0.0, 50 / w0, tuple(Peak(t, error(t)) for t in times), Ending.COMPLETE, setpoint, 1e-6)


def pi(zeta: float, w0: float = 1.0, slope: float = 0.1) -> PidGains:
    """Gains with which the process slope/s has this damping."""
    kc, tau_i = 2 * zeta * w0 / slope, 2 * zeta / w0
    return PidGains(kc, kc / tau_i)


def asked(response: Response, gains: PidGains, cause: Cause | None = None) -> SlowAdvice:
    diagnosis = Diagnosis(cause, 0.9, {}, f"because of {cause}") if cause else None
    return slow_oscillation_online(response, gains, diagnosis, SETTINGS)


@given(
    zeta=st.floats(0.02, 0.59),
    w0=st.floats(1e-4, 1e2),
    slope=st.floats(1e-3, 10),
    sign=st.sampled_from([1, -1]),
    setpoint=st.booleans(),
)
def test_afterwards_the_product_is_four(zeta: float, w0: float, slope: float, sign: int, setpoint: bool) -> None:
    gains = pi(zeta, w0, sign * slope)
    advice = asked(swing(zeta, w0, setpoint=setpoint), gains)
    assert advice.reading is SlowReading.APPLIES
    new = advice.tuning.gains
    product = sign * slope * new.kp * new.kp / new.ki
    assert 3.8 < product < 4.2
    assert product == pytest.approx(4.0, rel=1e-6)
    assert new.ki == pytest.approx(gains.ki)


@pytest.mark.parametrize(("zeta", "printed"), [(0.05, 396), (0.1, 99.7), (0.2, 25.7), (0.3, 12.1), (0.5, 5.3)])
def test_the_printed_factor_stands_beside_the_exact_one(zeta: float, printed: float) -> None:
    """Skogestad's f = 0.1 (P0/tau_I)^2 against the exact 1/zeta^2: tuning-rule tables."""
    numbers = asked(swing(zeta), pi(zeta)).numbers.to_dict()
    assert numbers["factor"] == pytest.approx(1 / zeta**2)
    assert numbers["printed_factor"] == pytest.approx(printed, rel=0.01)


@pytest.mark.parametrize("locks", [Locks(kc=True), Locks(tau_i=True)])
def test_where_one_is_locked_the_other_takes_it_all(locks: Locks) -> None:
    gains = pi(0.2)
    new = slow_oscillation_online(swing(0.2), gains, None, SETTINGS, locks).tuning
    assert 0.1 * new.gains.kp**2 / new.gains.ki == pytest.approx(4.0)
    assert (new.gains.kp == gains.kp) == locks.kc
    assert (new.gains.kp / new.gains.ki == pytest.approx(gains.kp / gains.ki)) == locks.tau_i


def test_zeta_and_period_belong_together() -> None:
    for zeta in (0.01, 0.1, 0.3, 0.5, 0.7):
        ratio = math.pi / (zeta * math.sqrt(1 - zeta**2))
        assert zeta_of(ratio) == pytest.approx(zeta)
    assert zeta_of(2 * math.pi) == pytest.approx(math.sqrt(0.5))


def tone(period_s: float) -> Response:
    peaks = tuple(Peak(period_s * i / 2, (-1.0) ** i) for i in range(3))
    return Response(0.0, 2 * period_s, peaks, Ending.COMPLETE, False, 0.01)


CUT = swing(0.3)
CASES = {
    SlowReading.APPLIES: asked(swing(0.3), pi(0.3), Cause.SLOW_INTEGRATING),
    SlowReading.NO_PI: asked(swing(0.3), PidGains(2.0, 0.0)),
    SlowReading.OTHER_CAUSE: asked(swing(0.3), pi(0.3), Cause.EXTERNAL),
    SlowReading.CUT_SHORT: asked(
        Response(CUT.t_start_s, CUT.t_end_s, CUT.peaks, Ending.SETPOINT, False, CUT.band), pi(0.3)
    ),
    SlowReading.NO_SWING: asked(
        Response(CUT.t_start_s, CUT.t_end_s, CUT.peaks[:1], Ending.QUIET, False, CUT.band), pi(0.3)
    ),
    SlowReading.NOT_SLOW: asked(swing(0.3), PidGains(2.0, 0.1)),
    SlowReading.NOT_ALIKE: asked(tone(100.0), PidGains(2.0, 0.2)),
    SlowReading.DAMPED: asked(swing(0.65), pi(0.65)),
}


@pytest.mark.parametrize("reading", SlowReading)
def test_every_reading_is_reached_and_says_why(reading: SlowReading) -> None:
    advice = CASES[reading]
    assert advice.reading is reading
    assert (advice.tuning is not None) == (reading is SlowReading.APPLIES)
    assert "{" not in advice.sentence


@pytest.mark.parametrize("cause", Cause)
def test_only_where_integral_action_may_be_the_cause(cause: Cause) -> None:
    may = cause in {Cause.SLOW_INTEGRATING, Cause.SLUGGISH, Cause.UNKNOWN}
    assert (asked(swing(0.3), pi(0.3), cause).reading is SlowReading.APPLIES) == may


@given(ratio=st.floats(1.0, 40.0))
def test_a_tone_from_outside_moves_nothing_at_the_periods_of_ordinary_loops(ratio: float) -> None:
    assert asked(tone(10.0 * ratio), PidGains(2.0, 0.2)).tuning is None


def test_derivative_keeps_its_time() -> None:
    gains = pi(0.3)
    new = asked(swing(0.3), PidGains(gains.kp, gains.ki, 0.5 * gains.kp)).tuning
    assert new.gains.kd / new.gains.kp == pytest.approx(0.5)


@pytest.mark.parametrize("settings", [{"unlike": 0.0}, {"damped": 0.9}, {"unlike": math.nan}])
def test_settings_out_of_range_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="is outside"):
        SlowSettings(**settings)
