"""`retuner.simulate`, the history of a controller, and pictures: each by the names that people type."""

import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import retuner
from retuner import LoopTrend, PidController, PidGains, ProcessModel, ProcessType, simulate

MODEL = ProcessModel(ProcessType.FOPDT, k=2.0, tau1_s=30.0, theta_s=5.0)


def test_a_model_under_gains_settles_where_it_should() -> None:
    trend = simulate(MODEL, PidGains(1.5, 0.05), setpoint=[(0, 50), (60, 55)], loads=[(400, 5)], until_s=900.0)
    assert len(trend.t_s) == 900
    assert trend.pv[:61] == pytest.approx(50.0)
    assert trend.pv[399] == pytest.approx(55.0, abs=1e-3)
    assert trend.pv[-1] == pytest.approx(55.0, abs=1e-3)
    assert trend.co[-1] == pytest.approx(50.0 + 2.5 - 5.0, abs=1e-2)
    assert float(np.max(np.abs(trend.pv[400:] - 55.0))) > 0.5
    assert trend.changes_s == []


def test_a_function_is_a_process_and_anything_with_step_a_controller() -> None:
    level = [20.0]

    def heater(co: float, dt_s: float) -> float:
        level[0] += dt_s * (1.5 * co - (level[0] - 20.0)) / 50.0
        return level[0]

    class OnOff:
        def step(self, sp: float, pv: float) -> float:
            return 100.0 if pv < sp else 0.0

    trend = simulate(heater, OnOff(), setpoint=60.0, until_s=600.0, start_pv=20.0)
    assert set(trend.co) == {0.0, 100.0}
    assert trend.pv[300:].mean() == pytest.approx(60.0, abs=3.0)
    assert np.isnan(trend.kp).all()


def test_noise_is_the_same_for_the_same_seed() -> None:
    runs = [
        simulate(MODEL, PidGains(1.5, 0.05), setpoint=50, until_s=50.0, noise=0.2, seed=seed).pv for seed in (1, 1, 2)
    ]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"until_s": 0.0}, "until_s = 0"),
        ({"until_s": 10.0, "dt_s": -1.0}, "dt_s = -1"),
        ({"until_s": 1e9}, "are over 10000000"),
        ({"until_s": 10.0, "setpoint": [(5, 1.0)]}, "from 0 s on"),
        ({"until_s": 10.0, "setpoint": [(0, 1.0), (0, 2.0)]}, "increasing seconds"),
        ({"until_s": 10.0, "loads": math.nan}, "loads = nan"),
    ],
)
def test_what_makes_no_simulation_is_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        simulate(MODEL, PidGains(1.5, 0.05), **{"setpoint": 50.0, **wrong})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the process gave no finite number"):
        simulate(lambda co, _: co + math.nan, PidGains(1.0, 0.1), setpoint=50.0, until_s=10.0)


def a_controller(**options: object) -> PidController:
    return PidController.from_kc(0.3, 100.0, dt_s=1.0, pv_range=(0.0, 200.0), **options)


def test_a_controller_from_kc_is_one_from_gains() -> None:
    assert a_controller().gains == PidGains.from_ideal(0.3, 100.0)
    series = PidController.from_kc(2.0, 20.0, 5.0, form="series", dt_s=1.0, pv_range=(0.0, 10.0))
    assert series.gains == PidGains.from_series(2.0, 20.0, 5.0)
    with pytest.raises(ValueError, match="form = 'parallel' is unknown; use ideal, series"):
        PidController.from_kc(2.0, 20.0, form="parallel", dt_s=1.0, pv_range=(0.0, 10.0))


@pytest.mark.slow
def test_a_controller_keeps_its_history_and_draws_it() -> None:
    pid = a_controller(mode="auto")
    trend = simulate(MODEL, pid, setpoint=lambda t: 50.0 + 5.0 * (t // 400 % 2), until_s=2000.0, noise=0.02)
    assert isinstance(pid.history, pd.DataFrame)
    assert list(pid.history) == ["t", "sp", "pv", "co", "kp", "ki", "kd"]
    np.testing.assert_array_equal(pid.history["co"], trend.co)
    assert pid.gains != PidGains.from_ideal(0.3, 100.0)
    assert trend.changes_s
    assert pid.trend.changes_s == [t_s + 1.0 for t_s in trend.changes_s]  # the next step works with them
    assert isinstance(pid.plot(), Figure)
    assert pid._repr_html_().count("<img") == 1
    assert trend._repr_html_().count("<img") == 1
    assert trend.part(1500.0, 2000.0).error < trend.part(0.0, 500.0).error


def test_a_controller_before_its_first_step_shows_words_only() -> None:
    pid = a_controller()
    assert "<img" not in pid._repr_html_()
    assert repr(pid.trend) == "LoopTrend(0 samples: nothing yet, gains changed 0 times)"
    with pytest.raises(ValueError, match="no samples yet"):
        pid.plot()


def test_history_is_bounded() -> None:
    pid = a_controller(history=10)
    for i in range(57):
        pid.step(50.0, float(i))
    assert pid.history["pv"].tolist() == [float(i) for i in range(47, 57)]
    none = a_controller(history=0)
    none.step(50.0, 1.0)
    assert len(none.history) == 0
    with pytest.raises(ValueError, match="history = -1"):
        a_controller(history=-1)


@pytest.mark.slow
def test_a_diagnosis_is_read_without_digging_and_drawn() -> None:
    found = retuner.diagnose(
        simulate(MODEL, PidGains(3.4, 0.2), setpoint=[(0, 50), (100, 55)], until_s=600.0, noise=0.05).frame(),
        gains=PidGains(3.4, 0.2),
    )
    assert found.cause == "aggressive"
    assert found.active == PidGains(3.4, 0.2)
    assert found.recommended == found.settings.gains
    assert found.margins == found.settings.margins
    assert found.model.k == pytest.approx(2.0, rel=0.1)
    figure = found.plot()
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert any(title.startswith("the same record with the new settings: mean error ") for title in titles)
    assert "setpoint step of 1" in titles
    assert found._repr_html_().count("<img") == 1


def test_an_identification_draws_itself() -> None:
    t = np.arange(0.0, 300.0)
    pv = 100.0 - 20.0 * np.expm1(-np.maximum(t - 25.0, 0.0) / 30.0)
    found = retuner.identify(t, pv, pv, np.where(t < 20.0, 50.0, 60.0), open_loop=True)
    assert found.recommended == found.settings.gains
    assert found.margins == found.settings.margins
    assert isinstance(found.plot(), Figure)


def test_a_loop_at_rest_is_drawn_at_rest() -> None:
    trend = simulate(MODEL, PidGains(1.5, 0.05), setpoint=50.0, until_s=600.0, noise=0.1)
    pv, co = trend.plot().axes
    assert pv.get_ylim()[1] - pv.get_ylim()[0] >= 0.75
    assert co.get_ylim()[1] - co.get_ylim()[0] >= 10.0
    assert isinstance(trend, LoopTrend)
