"""The drawings of a page: whole SVG, what must be in them, and nothing that a strange loop could break."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from decision_documents import COMMIT, MODEL, REFUSED, RESPONSE, RESTORED, changed, samples, view
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.decision_page.decision_view import samples_of
from retuner.decision_page.drawing_style import AFTER, MARK, TONES, steps, thinned
from retuner.decision_page.panel import FAR, Panel, Stroke, page_of, room, ticks_of
from retuner.decision_page.response_drawing import response_svg, time_unit
from retuner.decision_page.robustness_drawing import robustness_svg


def texts(svg: str) -> list[str]:
    return ["".join(one.itertext()) for one in ET.fromstring(svg).iter() if one.tag.endswith("text")]


def test_the_response_shows_peaks_model_load_and_units() -> None:
    shown = texts(response_svg(view()))
    for label in (
        "E1 = 15",
        "E2 = -8",
        "E3 = 2.4",
        "pv, sp [degC]",
        "co [%]",
        "pv as the model has it",
        "noise band",
        "load step as the fit places it",
        "time since the response began [s]",
    ):
        assert label in shown


def test_the_robustness_drawing_names_ms_and_the_circle() -> None:
    shown = texts(robustness_svg(view(), 1.75))
    assert "Ms = 1.75" in shown
    assert "after, 2 other plausible models" in shown
    assert sum(one.startswith(("before: Ms", "after: Ms")) for one in shown) == 2
    assert "predicted: setpoint step of 1 degC" in shown


def test_a_refusal_shows_what_was_proposed_beside_the_loop_in_force() -> None:
    shown = texts(robustness_svg(view(REFUSED), 1.8))
    assert any(one.startswith("active: Ms") for one in shown)
    assert any(one.startswith("proposed: Ms") for one in shown)
    assert not any(one.startswith(("before", "after")) for one in shown)
    alone = texts(robustness_svg(view({**REFUSED, "proposal": None}), 1.8))
    assert not any(one.startswith("proposed") for one in alone)


def test_without_samples_or_model_there_is_no_drawing() -> None:
    assert response_svg(view(drawn=False)) == ""
    assert robustness_svg(view(changed(estimate=None, verdict=None)), 1.8) == ""


def test_equal_decisions_give_equal_drawings_and_others_other_ids() -> None:
    assert response_svg(view()) == response_svg(view())
    ids = [set(re.findall(r'clipPath id="([^"]*)"', response_svg(view(changed(number=n))))) for n in (1, 2)]
    assert ids[0]
    assert not ids[0] & ids[1]


@pytest.mark.slow
@pytest.mark.uncounted
@settings(max_examples=examples(12))
@given(
    st.sampled_from(["fopdt", "integrating", "integrating-lag", "sopdt"]),
    st.floats(-6, 6),
    st.floats(-3, 3),
    st.sampled_from([1.0, -1.0]),
    st.booleans(),
)
def test_loops_of_all_kinds_are_drawn(kind, log_k, log_gain, sign, integral_only):
    lags = {"fopdt": (90.0, 0.0), "sopdt": (90.0, 20.0), "integrating": (0.0, 0.0), "integrating-lag": (0.0, 20.0)}[
        kind
    ]
    model = {"type": kind, "k": sign * 10**log_k, "tau1": lags[0], "tau2": lags[1], "theta": 10.0}
    gain = sign * 10 ** (log_gain - log_k)
    before = {"kp": 0.0 if integral_only else gain, "ki": gain / 90, "kd": 0.0}
    document = changed(
        estimate={"model": model, "std": {}},
        gains_before=before,
        gains_after={"kp": gain / 3, "ki": gain / 300, "kd": 0.0},
        verdict=None,
    )
    assert "Ms = 1.8" in texts(robustness_svg(view(document), 1.8))


def test_thinning_keeps_the_extremes_and_the_ends() -> None:
    x = np.arange(50_000.0)
    y = np.sin(x / 3000)
    y[31_234], y[17] = 5.0, -7.0
    at, kept = thinned(x, y, 400)
    assert len(at) <= 402
    assert (kept.max(), kept.min(), at[0], at[-1]) == (5.0, -7.0, 0.0, 49_999.0)
    assert np.all(np.diff(at) > 0)
    assert thinned(x[:100], y[:100], 400)[0] is not None


def test_a_held_signal_is_drawn_as_steps() -> None:
    x, y = steps(np.array([0.0, 1.0, 2.0]), np.array([5.0, 7.0, 6.0]))
    assert x.tolist() == [0, 1, 1, 2, 2]
    assert y.tolist() == [5, 5, 7, 7, 6]


@pytest.mark.parametrize(("span", "unit"), [(30.0, "s"), (700.0, "min"), (40_000.0, "h")])
def test_time_is_told_in_a_unit_that_suits(span: float, unit: str) -> None:
    assert time_unit(span)[1] == unit


def test_samples_begin_in_the_region_and_after_a_gap() -> None:
    whole = samples()
    columns = {"t": whole.t_s, "sp": whole.sp, "pv": whole.pv, "co": whole.co, "region": np.zeros(len(whole.t_s))}
    plain = samples_of(columns, RESPONSE, 1500.0)
    assert (plain.t_s[0], plain.t_s[-1]) == (1000.0, 1500.0)
    columns["region"] = np.where(whole.t_s < 1050, 1.0, 0.0)
    cut = samples_of(columns, RESPONSE, 1500.0)
    assert cut.t_s[0] == 1050.0
    assert samples_of(columns, {}, 1500.0) is None  # fewer than are shown without a response
    longer = {name: np.concatenate([values, values]) for name, values in columns.items()}
    longer["t"] = 1000.0 + 2.0 * np.arange(len(longer["t"]))
    longer["region"] = np.zeros(len(longer["t"]))
    longer["sequence"] = np.where(longer["t"] < 2000.0, 1.0, 2.0)
    last = samples_of(longer, {}, 2198.0)
    assert last.t_s[-1] == 2198.0
    assert len(last.t_s) >= 300
    assert last.changed_s == (2000.0,)
    shown = texts(response_svg(replace(view(RESTORED), samples=last)))
    assert "other gains run" in shown
    assert "time [min]" in shown
    assert samples_of(columns, {"t_start_s": 9000.0, "t_end_s": 9100.0}, 9100.0) is None


def test_a_model_without_dead_time_is_drawn() -> None:
    document = changed(estimate={**COMMIT["estimate"], "model": {**MODEL, "theta": 0.0}}, verdict=None)  # type: ignore[dict-item]
    assert robustness_svg(view(document), 1.8)


# Panels of curves: round ticks, lines that break where nothing is known, values of any size


PLACE = (500, 300, 4000, 1000)


def paths(panel: Panel) -> list[str]:
    """What is drawn inside the panel's edges."""
    inside = panel.drawn("a", "time [s]", "pv").split("<g clip-path", 1)[1].split("</g>", 1)[0]
    return re.findall(r' d="([^"]*)"', inside)


@pytest.mark.parametrize(
    ("over", "most", "ticks"),
    [
        ((0.0, 10.0), 5.0, [0, 2, 4, 6, 8, 10]),
        ((-0.3, 0.7), 4.0, [-0.25, 0, 0.25, 0.5]),
        ((101_320.0, 101_330.0), 2.0, [101_320, 101_325, 101_330]),
        ((1e-7, 3e-7), 2.0, [1e-7, 2e-7, 3e-7]),
    ],
)
def test_ticks_are_round(over: tuple[float, float], most: float, ticks: list[float]) -> None:
    assert ticks_of(over, most) == pytest.approx(ticks)


def test_a_line_breaks_where_nothing_is_known() -> None:
    panel = Panel(PLACE, (0.0, 4.0), (0.0, 2.0))
    panel.curve(np.arange(5.0), np.array([0.0, 1.0, np.nan, 1.0, 2.0]), Stroke(AFTER))
    assert paths(panel) == ["M500 1300 1500 800M3500 800 4500 300"]
    panel.curve([np.nan], [1.0], Stroke(AFTER))
    assert paths(panel)[1] == ""


def test_what_runs_away_is_cut_off_far_outside() -> None:
    panel = Panel(PLACE, (0.0, 1.0), (0.0, 1.0))
    panel.curve([0.0, 1.0], [0.5, -1e30], Stroke(AFTER))
    assert paths(panel) == [f"M500 800 4500 {FAR}"]


def test_one_sample_and_a_constant_are_drawn() -> None:
    panel = Panel(PLACE, (7.0, 7.0), room([[3.0, np.nan]], 0.05))
    panel.curve([7.0], [3.0], Stroke(MARK), "pv < sp & more")
    drawing = ET.fromstring(page_of([panel.drawn("a", "time [s]", "pv")], (5000, 1700), 'of "one"'))
    assert drawing.get("aria-label") == 'of "one"'
    assert "pv < sp & more" in ["".join(one.itertext()) for one in drawing.iter() if one.tag.endswith("text")]


def test_room_keeps_its_limits_and_its_least_length() -> None:
    assert room([[0.0, 9.0]], 0.1, -1.0, 2.0) == pytest.approx((-0.2, 2.2))
    assert room([[4.0, 5.0]], 0.1, floor=10.0) == pytest.approx((-0.5, 9.5))
    assert room([np.full(3, np.nan)], 0.1) == pytest.approx((-0.1, 0.1))


def test_colours_follow_the_page() -> None:
    assert Stroke(AFTER).style.startswith(f"stroke:var(--{TONES[AFTER]})")
    assert Stroke("#cc79a7", 0).style.startswith("fill:#cc79a7")
