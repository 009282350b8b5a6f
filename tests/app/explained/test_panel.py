"""Panels of curves: round ticks, lines that break where nothing is known, values of any size."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from retuner.decision_page.drawing_style import AFTER, MARK, TONES
from retuner.decision_page.panel import FAR, Panel, Stroke, page_of, room, ticks_of

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
