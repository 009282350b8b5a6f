"""Every number that the sources print, to the printed digits: data/tuning/published.toml."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from retuner import LinearProcess, ProcessModel, ProcessType, tune
from retuner.adaptive.loop.margins import margins, ultimate
from retuner.adaptive.loop.optimum import Aim, optimal_pi
from retuner.adaptive.loop.performance import performance, weighted_cost
from retuner.adaptive.loop.simulate import step_response
from retuner.adaptive.rules.simc import ControllerKind, simc, without_second_lag
from retuner.schedule.gains import PidGains, SeriesGains

PUBLISHED = tomllib.loads((Path(__file__).parents[2] / "data" / "tuning" / "published.toml").read_text())


def cases(table: str) -> list:
    return [pytest.param(case, id=case["source"]) for case in PUBLISHED[table]]


def assert_printed(value: float, printed: str, units: float = 0.5) -> None:
    """The value is what was printed, to half a unit of the last digit."""
    if printed == "inf":
        assert math.isinf(value)
        return
    digits = len(printed.partition(".")[2])
    assert value == pytest.approx(float(printed), abs=units * 10**-digits * 1.001)


def process_of(case: dict) -> LinearProcess:
    p = case["process"]
    return LinearProcess(
        p["k"], tuple(p.get("lags", ())), tuple(p.get("leads", ())), p.get("theta", 0.0), p.get("integrators", 0)
    )


def gains_of(case: dict) -> PidGains:
    g = case["gains"]
    return PidGains(0.0, g["ki"]) if "ki" in g else SeriesGains(g["kc"], g["tau_i"], g.get("tau_d", 0.0)).to_parallel()


@pytest.mark.parametrize("case", cases("settings"))
def test_settings(case: dict) -> None:
    model = None
    if "model" in case:
        m = case["model"]
        model = ProcessModel(ProcessType(m["type"]), m["k"], m.get("tau1", 0.0), m.get("tau2", 0.0), m["theta"])
    readings = {name: case[name] for name in ("ku", "pu", "kq", "pq", "tau_c") if name in case}
    found = tune(model, case["rule"], kind=case["kind"], **readings)
    gains = found.to_dict()["gains"]
    assert_printed(gains["kc"], case["kc"])
    if "tau_i" in case:
        assert_printed(gains["tau_i"], case["tau_i"])
    else:
        assert gains["tau_i"] is None
    assert_printed(gains["tau_d"], case.get("tau_d", "0.000"))


@pytest.mark.parametrize("case", cases("margins"))
def test_margins(case: dict) -> None:
    found = margins(process_of(case), gains_of(case))
    assert found.stable
    values = {
        "ms": found.ms,
        "mt": found.mt,
        "gm": found.gm,
        "pm": found.pm_deg,
        "delay": found.delay_margin_s,
        "w180": found.w180,
        "wc": found.wc,
    }
    for name, value in values.items():
        if name in case:
            assert_printed(value, case[name])


@pytest.mark.parametrize("case", cases("performance"))
def test_performance(case: dict) -> None:
    found = performance(process_of(case), gains_of(case))
    units = case.get("units", 0.5)
    assert_printed(found.iae_setpoint, case["iae_setpoint"], units)
    assert_printed(found.iae_load, case["iae_load"], units)
    j = weighted_cost(found, *case["references"])
    if "j_right" in case:  # the printed J contradicts the paper's own table 1
        assert j == pytest.approx(case["j_right"], abs=6e-4)
        assert abs(j - float(case["j"])) > 0.1
    else:
        assert_printed(j, case["j"], units)
    assert_printed(margins(process_of(case), gains_of(case)).ms, case["ms"], units)


@pytest.mark.parametrize("case", cases("optimum"))
def test_optimum(case: dict) -> None:
    """IAE within 0.3 % of the printed (their Ms is 1.59 within rounding), settings within 6 % (the optima are flat)."""
    process = process_of(case)
    for aim in (Aim.SETPOINT, Aim.LOAD):
        found, printed = optimal_pi(process, 1.59, aim), case[str(aim)]
        iae = found.iae_setpoint if aim == Aim.SETPOINT else found.iae_load
        assert iae == pytest.approx(printed["iae"], rel=3e-3)
        assert found.gains.kp == pytest.approx(printed["kc"], rel=0.06)
        assert margins(process, found.gains).ms == pytest.approx(1.59, abs=1e-6)
        if "tau_i" in printed:
            assert found.gains.kp / found.gains.ki == pytest.approx(printed["tau_i"], rel=0.06)
        else:
            assert found.gains.ki == 0
    both, printed = optimal_pi(process, 1.59), case["both"]
    assert both.gains.kp == pytest.approx(printed["kc"], rel=0.02)
    assert both.gains.kp / both.gains.ki == pytest.approx(printed["tau_i"], rel=0.02)
    assert both.iae_setpoint == pytest.approx(printed["iae_setpoint"], rel=5e-3)
    assert both.iae_load == pytest.approx(printed["iae_load"], rel=2e-3)
    assert both.cost == pytest.approx(printed["j"], abs=0.0085)


def test_ultimate_of_the_slides_example() -> None:
    # Putra slides: 4 e^-3.5s/(7s+1) has Ku 0.95 and Pu 12 as printed (read off a response, so two digits)
    ku, pu = ultimate(LinearProcess(4.0, (7.0,), (), 3.5))
    assert ku == pytest.approx(0.95, rel=0.01)
    assert pu == pytest.approx(12, rel=0.03)


def test_the_slides_reaction_curve_slip_would_be_unstable() -> None:
    # 0.33 L instead of L/0.3 = 3.33 L for Ti of the PI rule (their example process again)
    process, good = (
        LinearProcess(4.0, (7.0,), (), 3.5),
        tune(ProcessModel(ProcessType.FOPDT, 4.0, 7.0, 0.0, 3.5), "zn-reaction").tuning.gains,
    )
    assert margins(process, good).stable
    assert not margins(process, PidGains(good.kp, good.kp / (0.33 * 3.5))).stable


def test_averaging_level_control_uses_the_room_of_the_tank() -> None:
    """Marlin 1995, section 18.3: Kc = 0.736 dF/dL and TI = 4/(k' Kc), so that a step dF moves the level by dL."""
    model = ProcessModel(ProcessType.INTEGRATING, 0.02)
    found = tune(model, "averaging", u0=10.0, y_max=5.0).gains
    assert found.kp == pytest.approx(0.7358 * 10 / 5, rel=1e-4)
    assert found.kp / found.ki == pytest.approx(4 / (0.02 * found.kp))
    answer = step_response(model.linear(), found, 1000.0, 0.0, load=True)
    assert 10.0 * np.max(answer.pv) == pytest.approx(5.0, rel=1e-3)
    assert -np.min(answer.co) == pytest.approx(1 + math.exp(-2), rel=1e-3)
    with pytest.raises(ValueError, match="no room to average"):
        tune(ProcessModel(ProcessType.INTEGRATING, 0.02, theta_s=60.0), "averaging", u0=10.0, y_max=5.0)


# ---- SIMC against the table and examples of Skogestad (2003), and dimensional analysis

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


@pytest.mark.parametrize(("lead", "theta"), [(16.0, 3.0), (60.0, 3.0), (2.0, 0.5), (5.0, 20.0)])
def test_a_lead_leaves_the_first_order_that_is_the_same_at_rest_and_at_crossover(lead: float, theta: float) -> None:
    model = ProcessModel(T.SOPDT_LEAD, 2.0, 40.0, 6.0, theta, inverse_s=-lead)
    plain = without_second_lag(model)
    assert (plain.type, plain.k) == (T.FOPDT, 2.0 * max(lead / 40.0, 1.0))
    assert plain.theta_s >= theta
    w = np.geomspace(1e-4, 10.0, 20001)
    phase = np.unwrap(np.angle(model.linear().response(w)))
    last = w[np.flatnonzero(phase > -0.5 - np.pi / 2)[-1]]
    assert plain.slope == pytest.approx(last * abs(model.linear().response(np.array([last]))[0]), rel=2e-3)
    without = ProcessModel(T.SOPDT_LEAD, 2.0, 40.0, 6.0, 0.0, inverse_s=-lead)
    assert without_second_lag(without).slope == pytest.approx(2.0 * lead / (40.0 * 6.0), rel=1e-3)


def test_an_inverse_response_counts_as_dead_time() -> None:
    inverse = ProcessModel(T.SOPDT_INVERSE, 2.0, 10.0, 3.0, 1.0, inverse_s=1.5)
    plain = ProcessModel(T.SOPDT, 2.0, 10.0, 3.0, 2.5)
    assert without_second_lag(inverse) == without_second_lag(plain)
    for kind in (ControllerKind.PI, ControllerKind.PID):
        assert simc(inverse, kind=kind).gains == simc(plain, kind=kind).gains
