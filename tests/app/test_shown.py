"""Results show themselves: a line when they are named, the command's lines when printed, a picture in a notebook."""

import ast
import inspect
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import retuner
from retuner import PidGains, ProcessModel, ProcessType
from retuner.adaptive import display_hook
from retuner.api import window_of

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
    typed = {alias.asname for node in checked.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == set(retuner.__all__) == set(retuner._HOME_OF)
    assert {*retuner.__all__, "__version__"} == set(dir(retuner))
    assert retuner.__version__.split(".")[0].isdigit()
