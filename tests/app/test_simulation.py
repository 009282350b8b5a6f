"""`retuner.simulate`, the history of a controller, and pictures: each by the names that people type."""

import ast
import inspect
import math
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from matplotlib.figure import Figure

import retuner
from retuner import LoopTrend, PidController, PidGains, ProcessModel, ProcessType, simulate
from retuner.adaptive import display_hook
from retuner.api import window_of

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


# Results show themselves: a line when they are named, the command's lines when printed, a picture in a notebook.


DATA = Path(__file__).resolve().parents[1] / "data"
EXPORT = DATA / "raw" / "historian_export_1.txt"


def step_test() -> dict[str, np.ndarray]:
    """Gain 2, lag 30 s, dead time 5 s, in manual."""
    t = np.arange(0.0, 300.0, 1.0)
    pv = 100.0 - 20.0 * np.expm1(-np.maximum(t - 25.0, 0.0) / 30.0)
    return {"t": t, "sp": pv, "pv": pv, "co": np.where(t < 20.0, 50.0, 60.0)}


def test_a_frame_a_path_and_arrays_are_the_same_record() -> None:
    arrays = step_test()
    frame = pd.DataFrame(arrays)
    found = [retuner.identify(**arrays, open_loop=True), retuner.identify(frame, open_loop=True)]
    assert found[0].model == found[1].model is not None
    windows = [window_of(source) for source in (EXPORT, str(EXPORT), retuner.read(EXPORT))]
    assert all(np.array_equal(window.pv, windows[0].pv) for window in windows)
    with pytest.raises(ValueError, match="a record brings its own sp, pv and co"):
        retuner.identify(frame, arrays["sp"], arrays["pv"], arrays["co"])


def test_frames_of_every_library_and_their_columns_are_records() -> None:
    arrays = step_test()
    one, two, three = pd.DataFrame(arrays), pl.DataFrame(arrays), pa.table(arrays)
    expected = retuner.identify(one, open_loop=True).model
    assert expected is not None
    for frame in (two, three):
        assert retuner.identify(frame, open_loop=True).model == expected
    for frame in (one, two, three):
        columns = (frame[name] for name in ("t", "sp", "pv", "co"))
        assert retuner.identify(*columns, open_loop=True).model == expected


def test_a_record_says_what_it_is_in_a_line() -> None:
    found = retuner.read(EXPORT)
    assert len(repr(found)) < 400
    assert f"{len(found.recording.t_s)} samples over" in repr(found)
    assert found._repr_html_().count("<img") == 1


def test_an_identification_shows_the_process_and_the_settings() -> None:
    found = retuner.identify(**step_test(), open_loop=True)
    assert repr(found).startswith("Identification(fopdt: k 2 tau1 30 s theta 5 s; settings TuneResult(simc pi: kp 1.")
    assert "recommended settings" in str(found)
    assert found._repr_html_().count("<img") == 1
    still = retuner.identify(
        **{**step_test(), "co": np.linspace(50, 60, 300), "pv": np.arange(300.0) % 2}, open_loop=True
    )
    assert not still.identifiable
    assert still.model is None
    assert repr(still).startswith("Identification(not identifiable: ")


def test_a_diagnosis_shows_its_cause() -> None:
    window = window_of(EXPORT)
    found = retuner.diagnose(*(values[:200] for values in (window.t_s, window.sp, window.pv, window.co)))
    assert repr(found).startswith(f"RecordDiagnosis({found.cause}, confidence ")
    assert str(found).startswith(f"{str(found.cause).replace('_', ' ').upper()} (confidence ")
    assert found._repr_html_().count("<img") == 1


def test_settings_show_what_they_leave() -> None:
    model = ProcessModel(ProcessType.FOPDT, 2, 30, 0, 5)  # whole numbers, as people write them
    found = retuner.tune(model)
    assert repr(found) == "TuneResult(simc pi: kp 1.5, ki 0.05, kd 0, Ms 1.59)"
    assert "margins   Ms 1.59" in str(found)
    assert found.gains == PidGains(1.5, 0.05)
    assert found._repr_html_().count("<img") == 1
    assert "<img" not in retuner.tune(rule="zn-ultimate", ku=2.0, pu=20.0)._repr_html_()


def test_a_decision_shows_its_reason_and_its_page() -> None:
    pid = retuner.PidController(PidGains(12.0, 0.3), dt_s=1.0, pv_range=(0.0, 10.0))
    y, past = 0.0, [0.0] * 5
    for i in range(700):
        past.append(pid.step(float(i >= 100), y))
        y += (0.1 * past.pop(0) - y) / 50
        if pid.decision is not None:
            break
    made = pid.last_decision
    assert repr(made).startswith("Decision(1, 'loop', 'all', ")
    assert made.reason in str(made)
    assert "<svg" in made._repr_html_()
    assert "Decision" not in made._repr_html_()


def test_what_is_no_result_is_refused() -> None:
    class Other(display_hook.Shown):
        """Nothing that has words."""

    for show in (str, lambda result: result._repr_html_()):
        with pytest.raises(TypeError, match="Other is no result"):
            show(Other())


def test_three_lists_of_names_agree() -> None:
    tree = ast.parse(inspect.getsource(retuner))
    checked = next(node for node in tree.body if isinstance(node, ast.If))
    typed = {alias.name for node in checked.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == set(retuner.__all__) == set(retuner._HOME_OF)
    assert {*retuner.__all__, "__version__"} == set(dir(retuner))
    assert retuner.__version__.split(".")[0].isdigit()
