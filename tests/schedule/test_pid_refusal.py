"""What is no number, no time or no setting never gets into the law, and the state stays good."""

import math

import pytest

from retuner.schedule.gains import PidGains
from retuner.schedule.pid import PidLaw, law, start, step, track

BAD = (math.nan, math.inf, -math.inf)


@pytest.mark.parametrize("gains", [PidGains(1, 1, 1), PidGains(1, 0, 0), PidGains(0, 1, 0), PidGains(0, 0, -1)])
@pytest.mark.parametrize("b", [0.0, 0.5])
@pytest.mark.parametrize("tau_f_s", [0.0, 2.0])
@pytest.mark.parametrize("rate", [None, 3.0])
def test_what_is_no_number_is_refused_and_named(gains, b, tau_f_s, rate):
    """Whichever gains are zero, no NaN or infinity gets in; the next good sample goes on as if nothing had been."""
    settings = law(gains, b=b, tau_f_s=tau_f_s, co_rate_per_s=rate)
    state, _ = step(settings, start(settings, 50.0, 50.0, 50.0), 52.0, 51.0, 1.0)
    expected = step(settings, state, 52.0, 51.5, 1.0)
    for bad in BAD:
        for name, sp, pv, dt_s in (("sp", bad, 51.0, 1.0), ("pv", 52.0, bad, 1.0), ("dt_s", 52.0, 51.0, bad)):
            with pytest.raises(ValueError, match=name):
                step(settings, state, sp, pv, dt_s)
            with pytest.raises(ValueError, match=name):
                track(settings, state, sp, pv, 50.0, dt_s)
        with pytest.raises(ValueError, match="co"):
            track(settings, state, 52.0, 51.0, bad, 1.0)
        for sp, pv, co in ((bad, 50.0, 50.0), (50.0, bad, 50.0), (50.0, 50.0, bad)):
            with pytest.raises(ValueError, match="not a finite number"):
                start(settings, sp, pv, co)

    assert step(settings, state, 52.0, 51.5, 1.0) == expected


@pytest.mark.parametrize("dt_s", [0.0, -0.0, -1.0])
@pytest.mark.parametrize("tau_f_s", [0.0, 2.0])
def test_time_must_go_forward(dt_s, tau_f_s):
    settings = law(PidGains(1.0, 1.0, 1.0), tau_f_s=tau_f_s)
    state = start(settings, 50.0, 50.0, 50.0)
    with pytest.raises(ValueError, match=r"dt_s = .* must be positive"):
        step(settings, state, 50.0, 50.0, dt_s)
    with pytest.raises(ValueError, match=r"dt_s = .* must be positive"):
        track(settings, state, 50.0, 50.0, 50.0, dt_s)


def test_a_result_too_large_for_a_number_is_refused():
    settings = law(PidGains(1e300, 1.0))
    with pytest.raises(ValueError, match="too large"):
        step(settings, start(settings, 0.0, 0.0, 50.0), 1e300, 0.0, 1.0)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"b": 1.1}, "b = 1.1"),
        ({"b": -0.1}, "b = -0.1"),
        ({"b": math.nan}, "b = nan"),
        ({"tau_f_s": -1.0}, "tau_f_s"),
        ({"tau_f_s": math.inf}, "tau_f_s"),
        ({"tau_f_s": math.nan}, "tau_f_s"),
        ({"co_min": 100.0}, "co_min < co_max"),
        ({"co_max": math.inf}, "= inf"),
        ({"co_min": math.nan}, "co_min"),
        ({"co_rate_per_s": 0.0}, "co_rate_per_s"),
        ({"co_rate_per_s": math.nan}, "co_rate_per_s"),
        ({"co_rate_per_s": math.inf}, "None for no limit"),
    ],
)
def test_settings_out_of_range_are_refused(settings, what):
    with pytest.raises(ValueError, match=what):
        law(PidGains(1.0, 1.0), **settings)


def test_law_takes_its_gains_and_gives_them_back():
    settings = law(PidGains(1.0, 2.0, 3.0), b=0.5, tau_f_s=1.0, co_min=5.0, co_max=95.0, co_rate_per_s=2.0)
    other = settings.with_gains(PidGains(4.0, 5.0, 6.0))

    assert settings.gains == PidGains(1.0, 2.0, 3.0)
    assert other == PidLaw(4.0, 5.0, 6.0, 0.5, 1.0, 5.0, 95.0, 2.0)
    with pytest.raises(ValueError, match="different signs"):
        PidLaw(1.0, -1.0, 0.0)
