"""The half rule against every printed number, and what must hold for any process."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.signal import cont2discrete, tf2ss

from retuner.adaptive.fit.dynamics import SamplingInstants, through_lag
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.fit.search import with_one_more
from retuner.adaptive.fit.structure import LAG, SECOND, THIRD, parameters_of
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.identification.robust_simc import swings
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.process.reduction import Leads, against, half_rule, reduce, set_against
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.signals.sample import FloatArray, Window

E2 = LinearProcess(1.0, (2.0, 1.0, 0.4, 0.2, 0.05, 0.05, 0.05), (-0.3, 0.08))
E3 = LinearProcess(2.0, (20.0, 1.0, 0.1, 0.1), (15.0,))
E6 = LinearProcess(1.0, (1.0, 1.0, 0.028), (0.17, 0.17), 0.0, 1)
# process, order, printed (type, k, tau1, tau2, theta), half a unit of the last printed digit
PRINTED = {
    "Skogestad 2003 E1": (LinearProcess(1.0, (1.0, 0.2)), 1, ("fopdt", 1.0, 1.1, 0.0, 0.1), 0.0005),
    "Skogestad 2003 E2 PI": (E2, 1, ("fopdt", 1.0, 2.5, 0.0, 1.47), 0.0005),
    "Skogestad 2003 E2 PID": (E2, 2, ("sopdt", 1.0, 2.0, 1.2, 0.77), 0.0005),
    "Skogestad 2003 E3 PI": (E3, 1, ("fopdt", 1.5, 1.05, 0.0, 0.15), 0.0005),
    "Skogestad 2003 E3 PID": (E3, 2, ("sopdt", 1.5, 1.0, 0.15, 0.05), 0.0005),
    "Skogestad 2003 E4 PI": (LinearProcess(1.0, (1.0,) * 4), 1, ("fopdt", 1.0, 1.5, 0.0, 2.5), 0.0005),
    "Skogestad 2003 E5 PI": (LinearProcess(1.0, (1.0, 0.2, 0.04, 0.008)), 1, ("fopdt", 1, 1.1, 0.0, 0.148), 0.0005),
    "Skogestad 2003 E5 PID": (LinearProcess(1.0, (1.0, 0.2, 0.04, 0.008)), 2, ("sopdt", 1, 1, 0.22, 0.028), 0.0005),
    "Skogestad 2003 E6 PI": (E6, 1, ("integrating", 1.0, 0.0, 0.0, 1.69), 0.005),
    "Skogestad 2003 E6 PID": (E6, 2, ("integrating-lag", 1.0, 0.0, 1.33, 0.358), 0.0005),
    "Skogestad 2003 E7 PI": (LinearProcess(1.0, (1.0,) * 3, (-2.0,)), 1, ("fopdt", 1.0, 1.5, 0.0, 3.5), 0.0005),
    "Skogestad 2003 E8 PI": (LinearProcess(1, (1.0, 1.0), (), 0, 1), 1, ("integrating", 1.0, 0.0, 0.0, 1.5), 0.0005),
    "Skogestad 2003 E8 PID": (LinearProcess(1, (1.0, 1.0), (), 0, 1), 2, ("integrating-lag", 1, 0, 1.5, 0.5), 0.0005),
    "Skogestad 2003 E12": (LinearProcess(1, (10, 8, 1), (6, 3), 0.3), 1, ("fopdt", 0.225, 1.0, 0.0, 0.3), 0.0005),
    "Skogestad 2003 E13": (LinearProcess(1, (10, 0.5), (2,), 1), 1, ("fopdt", 0.625, 4.5, 0.0, 1.25), 0.0005),
    "Seborg 2011 example 6.4": (LinearProcess(1, (5, 3, 0.5), (-0.1,)), 1, ("fopdt", 1.0, 6.5, 0.0, 2.1), 0.0005),
    "Seborg 2011 example 6.5": (LinearProcess(1, (12, 3, 0.2, 0.05), (-1,), 1), 1, ("fopdt", 1, 13.5, 0, 3.75), 0.0005),
    "Seborg 2011 example 6.5, order 2": (
        LinearProcess(1, (12, 3, 0.2, 0.05), (-1,), 1),
        2,
        ("sopdt", 1, 12, 3.1, 2.15),
        0.0005,
    ),
    "tbcontrol, lead taken from the dead time": (
        LinearProcess(1, (20, 5, 5), (10,), 10),
        1,
        ("fopdt", 1, 22.5, 0, 7.5),
        0.0005,
    ),
}


@pytest.mark.parametrize("source", PRINTED)
def test_printed_reductions(source: str) -> None:
    process, order, (kind, k, tau1, tau2, theta), digits = PRINTED[source]
    model = half_rule(process, order)
    assert model.type == kind
    assert (model.k, model.tau1_s, model.tau2_s) == pytest.approx((k, tau1, tau2), abs=0.0005)
    assert model.theta_s == pytest.approx(theta, abs=digits)


def batch() -> dict[str, LinearProcess]:
    """The Astrom-Hagglund test batch."""
    t1 = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.3, 1.5, 2, 4, 6, 8, 10, 20, 50, 100, 200, 500, 1000)
    found = {f"P1 T={t}": LinearProcess(1, (t,), (), 1) for t in t1}
    found |= {f"P2 T={t}": LinearProcess(1, (t, t), (), 1) for t in (0.01, *t1[:-1])}
    found |= {f"P3 T={t}": LinearProcess(1, (1, t, t)) for t in (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 2, 5, 10)}
    found |= {f"P4 n={n}": LinearProcess(1, (1,) * n) for n in range(3, 9)}
    found |= {f"P5 a={a / 10}": LinearProcess(1, tuple((a / 10) ** i for i in range(4))) for a in range(1, 10)}
    for length in (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1):
        found[f"P6 L={length}"] = LinearProcess(1, (1 - length,), (), length, 1)
        for t in (1, 2, 5, 10):
            if length != 0.2:
                found[f"P7 T={t} L={length}"] = LinearProcess(t, (t, 1 - length), (), length)
    found |= {f"P8 a={a / 10}": LinearProcess(1, (1, 1, 1), (-a / 10,)) for a in range(1, 12)}
    found |= {f"P9 T={t / 10}": LinearProcess(1, (1,), quadratics=((0.14 * t, (t / 10) ** 2),)) for t in range(1, 11)}
    return found


def test_simc_on_the_standard_batch_has_the_published_range_of_ms() -> None:
    ms = {name: sensitivity_peak(process, simc(half_rule(process)).gains) for name, process in batch().items()}
    assert len(ms) >= 133
    ordered = sorted(ms.values())
    assert ordered[0] == pytest.approx(1.39, abs=0.006)
    assert ordered[-1] == pytest.approx(1.98, abs=0.006)
    assert ordered[len(ordered) // 2] == pytest.approx(1.59, abs=0.006)
    expected = {f"P6 L={x}" for x in (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)}
    expected |= {name for name in ms if name.startswith("P9")}
    assert {name for name, value in ms.items() if value > 1.8} == expected


def test_the_rules_for_numerator_time_constants_one_by_one() -> None:
    assert set_against(8.0, 4.0, 1.0)[:1] + set_against(8.0, 4.0, 1.0)[3:] == ("T1", 2.0, 0.0)
    assert set_against(8.0, 4.0, 5.0)[:1] + set_against(8.0, 4.0, 5.0)[3:] == ("T1a", 1.6, 0.0)
    assert set_against(8.0, 4.0, 9.0)[:1] + set_against(8.0, 4.0, 9.0)[3:] == ("T1b", 1.0, 0.0)
    assert set_against(8.0, 10.0, 1.0)[:1] + set_against(8.0, 10.0, 1.0)[3:] == ("T2", 0.8, 0.0)
    assert set_against(8.0, 10.0, 5.0)[:1] + set_against(8.0, 10.0, 5.0)[3:] == ("T3", 1.0, 2.0)
    assert set_against(8.0, 20.0, 2.0)[:1] + set_against(8.0, 20.0, 2.0)[3:] == ("T3", 0.5, 2.0)
    assert against(8.0, [20.0, 6.0]) == 6.0  # close: 8/6 < 20/8 and < 1.6
    assert against(0.08, [0.2, 0.05]) == 0.2  # 0.08/0.05 is 1.6, not less
    assert against(8.0, [9.0, 6.0]) == 9.0  # 8/6 > 9/8
    assert against(8.0, [math.inf, 1.0]) == math.inf


@given(lead=st.floats(0.1, 10.0), lag=st.floats(0.1, 10.0), theta=st.sampled_from(["lag", "lead", "fifth"]))
def test_neighbouring_rules_agree_at_their_boundaries(lead: float, lag: float, theta: str) -> None:
    assume(abs(lead / lag - 1) > 1e-3)
    at = {"lag": lag, "lead": lead, "fifth": lead / 5}[theta]
    below, above = (set_against(lead, lag, at * f) for f in (1 - 1e-9, 1 + 1e-9))
    assert below.factor == pytest.approx(above.factor, rel=1e-6)
    assert below.rest_s == pytest.approx(above.rest_s, abs=1e-6)


lag_lists = st.lists(st.floats(0.01, 100.0), min_size=1, max_size=6)
lead_lists = st.lists(st.floats(-5.0, 50.0).filter(lambda x: abs(x) > 0.01), max_size=2)


@st.composite
def processes(draw: st.DrawFn) -> LinearProcess:
    lags = draw(lag_lists)
    leads = draw(lead_lists)[: len(lags)]
    k = draw(st.sampled_from([-1, 1])) * draw(st.floats(0.01, 100.0))
    return LinearProcess(k, tuple(lags), tuple(leads), draw(st.floats(0.0, 10.0)), draw(st.integers(0, 1)))


def rounded(model: ProcessModel) -> tuple[object, ...]:
    return model.type, model.k, model.tau1_s, model.tau2_s, model.theta_s


@given(
    process=processes(),
    order=st.sampled_from([1, 2]),
    a=st.sampled_from([0.25, 2.0, 64.0]),
    g=st.sampled_from([-0.5, 4.0]),
)
def test_scaling_time_and_gain_scales_the_model(process: LinearProcess, order: int, a: float, g: float) -> None:
    plain = half_rule(process, order)
    scaled = half_rule(
        LinearProcess(
            g * process.k / a**process.integrators,
            tuple(a * x for x in process.lags_s),
            tuple(a * x for x in process.leads_s),
            a * process.theta_s,
            process.integrators,
        ),
        order,
    )
    assert scaled.type == plain.type
    per_second = 1 / a if plain.type in {ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG} else 1.0
    assert scaled.k == pytest.approx(g * plain.k * per_second, rel=1e-9)
    assert (scaled.tau1_s, scaled.tau2_s, scaled.theta_s) == pytest.approx(
        (a * plain.tau1_s, a * plain.tau2_s, a * plain.theta_s), rel=1e-9
    )


@given(lags=lag_lists, theta=st.floats(0.0, 10.0), inverse=st.floats(0.0, 3.0), order=st.sampled_from([1, 2]))
def test_without_leads_the_sum_of_all_times_stays(lags: list[float], theta: float, inverse: float, order: int) -> None:
    model = half_rule(LinearProcess(1.0, tuple(lags), (-inverse,) if inverse else (), theta), order)
    assert model.tau1_s + model.tau2_s + model.theta_s == pytest.approx(sum(lags) + theta + inverse, rel=1e-9)
    assert model.tau1_s >= model.tau2_s


@given(process=processes(), order=st.sampled_from([1, 2]))
def test_the_effective_dead_time_agrees_with_itself(process: LinearProcess, order: int) -> None:
    found = reduce(process, order, Leads.RULES)
    assert found.model.theta_s >= process.theta_s * (1 - 1e-12)
    assert math.copysign(1, found.model.k) == math.copysign(1, process.k)


@pytest.mark.parametrize("lag", [0.3, 1.0, 7.0])
def test_a_lead_that_equals_a_lag_cancels_it(lag: float) -> None:
    with_pair = half_rule(LinearProcess(2.0, (10.0, lag, 2.0), (lag,)))
    assert rounded(with_pair) == rounded(half_rule(LinearProcess(2.0, (10.0, 2.0))))


def test_a_double_pole_written_as_a_pair_is_the_same() -> None:
    assert half_rule(LinearProcess(1, (5.0,), quadratics=((4.0, 4.0),))) == half_rule(LinearProcess(1, (5.0, 2.0, 2.0)))
    assert half_rule(LinearProcess(1, (5.0,), quadratics=((5.0, 4.0),))) == half_rule(LinearProcess(1, (5.0, 4.0, 1.0)))


REFUSED = {
    "order": (LinearProcess(1, (1.0,)), 3, "order = 3"),
    "two integrators in first order": (LinearProcess(1, (), (), 1, 2), 1, "give order 2"),
    "three integrators": (LinearProcess(1, (), (), 1, 3), 2, "no rule"),
    "a resonance": (LinearProcess(1, (1.0,), quadratics=((0.2, 1.0),)), 1, "zeta of 0.1"),
    "more zeros than poles": (LinearProcess(1, (1.0,), (2.0, 3.0)), 1, "more zeros than poles"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_reduced_model_is_refused_in_one_line(case: str) -> None:
    process, order, words = REFUSED[case]
    with pytest.raises(ValueError, match=words) as refused:
        reduce(process, order)
    assert "\n" not in str(refused.value)


def test_subtracting_too_much_is_refused_with_the_way_out() -> None:
    with pytest.raises(ValueError, match="rules T1 to T3"):
        reduce(E3, 1, Leads.SUBTRACT)


def test_taking_a_lead_from_the_dead_time_is_the_bolder_choice() -> None:
    process = LinearProcess(1, (20, 5, 5), (10,), 10)
    ms = {leads: sensitivity_peak(process, simc(reduce(process, 1, leads).model).gains) for leads in Leads}
    assert ms[Leads.RULES] < 1.8 < ms[Leads.AUTO]


# ---- A third lag is found as what it is: what lacks one was explained by a load step that never came, and k with
# it

TOPDT = ProcessType.TOPDT
DT_S = 0.13


def record(seed: int, denominator: FloatArray, kc: float = 0.39, tau_i_s: float = 0.55) -> Window:
    """PI on 1/denominator: a setpoint step after 60 samples, 1 % noise."""
    rng, n = np.random.default_rng(seed), 220
    a, b, c, _, _ = cont2discrete(tf2ss([1.0], denominator), DT_S)
    x, integral = np.zeros(len(a)), 0.0
    pv, co, wanted = np.zeros(n), np.zeros(n), np.where(np.arange(n) >= 60, 1.0, 0.0)
    for i in range(n):
        pv[i] = float((c @ x).item()) + 0.01 * rng.standard_normal()
        integral += kc / tau_i_s * DT_S * (wanted[i] - pv[i])
        co[i] = kc * (wanted[i] - pv[i]) + integral
        x = a @ x + b[:, 0] * co[i]
    return Window(DT_S * np.arange(float(n)), wanted, pv, co)


SWINGS = np.polymul([1.0, 1.0], [1.0, 1.4, 1.0])
"""A lag and a damped second order: process P9 of Astrom and Hagglund's batch with T = 1."""


@pytest.mark.parametrize("seed", [1, 2])
def test_no_load_is_invented_and_the_gain_is_right(seed: int) -> None:
    found = identify_window(record(seed, SWINGS), sign=1)
    assert found.identifiable
    assert found.log.type == TOPDT
    assert found.load_times_s == ()
    assert found.log.model().k == pytest.approx(1.0, abs=2 * found.log.std()["k"])


def test_the_bigger_structure_is_never_the_worse_one_and_its_shortest_lag_is_the_third() -> None:
    of = Record.of(record(3, np.poly([-1.0, -1.0, -1 / 0.6])))
    plain = ProcessModel(ProcessType.SOPDT, 1.0, 1.2, 0.9, 0.4)
    fit = refine(Misfit(of, plain.type, 1, 0, of.noise_std, 0.3), parameters_of(plain))
    bigger = with_one_more(fit, TOPDT)
    total, c2, third = (math.exp(bigger.x[place[TOPDT]]) for place in (LAG, SECOND, THIRD))
    assert bigger.deviance < fit.deviance
    assert c2 > total / 4 or third <= total * (1 - math.sqrt(1 - 4 * c2 / total)) / 2 + 1e-9


@pytest.mark.parametrize("even", [True, False])
def test_a_ramp_through_a_lag_is_exact_at_any_interval(even: bool) -> None:
    t = np.arange(40) * 0.5 if even else np.cumsum(np.random.default_rng(1).uniform(0.1, 1.0, 40))
    t -= t[0]
    expected = t - 3.0 * -np.expm1(-t / 3.0)
    np.testing.assert_allclose(through_lag(SamplingInstants.of(t), t, 3.0), expected, atol=1e-9)


@pytest.mark.parametrize("model", [
    ProcessModel(TOPDT, 2.0, 9.0, 4.0, 1.0, tau3_s=2.0),
    ProcessModel(TOPDT, 2.0, 3.0, 2.0, 1.0, tau3_s=8.0),
    ProcessModel(TOPDT, 2.0, 3.0, 3.0, 1.0, 0.7, tau3_s=8.0),
])  # fmt: skip
def test_rules_take_it_by_the_half_rule(model: ProcessModel) -> None:
    linear = model.linear()
    assert isinstance(linear, LinearProcess)
    for order, found in ((1, without_second_lag(model)), (2, model.of_second_order())):
        expected = half_rule(linear, order=order)
        assert found.type == expected.type
        for name in ("k", "tau1_s", "tau2_s", "theta_s"):
            assert getattr(found, name) == pytest.approx(getattr(expected, name))


def test_it_swings_where_no_lag_is_longer_than_its_pair_of_poles() -> None:
    assert swings(ProcessModel(TOPDT, 1.0, 3.0, 3.0, 1.0, 0.7, tau3_s=2.0))
    assert not swings(ProcessModel(TOPDT, 1.0, 3.0, 3.0, 1.0, 0.7, tau3_s=8.0))


def test_only_this_structure_has_a_third_lag() -> None:
    with pytest.raises(ValueError, match="tau3_s = 2"):
        ProcessModel(ProcessType.SOPDT, 1.0, 3.0, 2.0, 1.0, tau3_s=2.0)
    with pytest.raises(ValueError, match="tau3_s = 0"):
        ProcessModel(TOPDT, 1.0, 3.0, 2.0, 1.0)


def test_equal_lags_are_known_as_far_as_the_misfit_says_and_not_its_derivative() -> None:
    found = identify_window(record(1, np.poly([-1.0, -1.0, -1.0])), sign=1)
    third = found.of(TOPDT).log
    assert max(np.linalg.eigvalsh(third.p)) < 1.0  # by the derivative alone a factor of e^3 either way
    assert third.gain_uncertainty(DT_S) < 0.25
