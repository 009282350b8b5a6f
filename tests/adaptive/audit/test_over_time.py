"""How a loop ran week by week: what is counted, and that pieces of a record tell the same."""

import math

import numpy as np
import pytest

from retuner.adaptive.audit.loop_screen import DAY_S, screen_loop
from retuner.adaptive.audit.over_time import WEEK_S, joined_parts, over_time, period_of
from retuner.adaptive.signals.sample import Window

STEP_S = 600.0
WEEK = round(WEEK_S / STEP_S)


def record() -> Window:
    """Four weeks: in order, in manual, at the upper limit for half of it, in order with half of the samples."""
    rng = np.random.default_rng(4)
    t_s = np.arange(4 * WEEK) * STEP_S
    pv, co = 50 + rng.normal(size=len(t_s)), 50 + 5 * np.sin(2 * math.pi * t_s / (DAY_S / 4))
    co[WEEK : 2 * WEEK] = 40.0
    co[2 * WEEK : 2 * WEEK + WEEK // 2] = 100.0
    pv[2 * WEEK : 2 * WEEK + WEEK // 2] -= 3.0
    keep = np.arange(len(t_s)) < 3.6 * WEEK
    return Window(t_s[keep], np.full(keep.sum(), 50.0), pv[keep], co[keep])


def test_each_week_has_its_numbers() -> None:
    order, manual, limit, short = over_time(record(), WEEK_S, 0.0)
    assert [part.begin_s for part in (order, manual, limit, short)] == [0.0, WEEK_S, 2 * WEEK_S, 3 * WEEK_S]
    assert (order.in_automatic, order.at_limits) == (1.0, 0.0)
    assert order.error == pytest.approx(math.sqrt(2 / math.pi), rel=0.1)  # the mean of |x| of a normal x
    assert order.reversals_per_day == pytest.approx(8.0, rel=0.05)  # of four periods a day
    assert (manual.in_automatic, manual.at_limits) == (pytest.approx(0.0, abs=0.01), 0.0)
    assert limit.at_limits == pytest.approx(0.5, abs=0.01)
    assert limit.in_automatic == pytest.approx(1.0, abs=0.01)
    assert short.span_s == pytest.approx(0.6 * WEEK_S, rel=0.01)


def test_short_saturations_do_not_hide_a_week_in_manual() -> None:
    whole = record()
    co = whole.co.copy()
    co[np.arange(len(co)) % 6 < 3] = 100.0  # half of the time, for half an hour each
    co[WEEK : 2 * WEEK] = 40.0
    screened = screen_loop(Window(whole.t_s, whole.sp, whole.pv, co))
    assert screened.at_limits == pytest.approx(0.43, abs=0.02)
    assert screened.in_automatic == pytest.approx(1 - WEEK / len(co), abs=0.01)


def test_pieces_of_a_week_tell_what_the_week_tells() -> None:
    whole = record()
    parts = []
    for half in (slice(0, WEEK // 2 + 200), slice(WEEK // 2 + 200, 2 * WEEK)):
        piece = Window(whole.t_s[half], whole.sp[half], whole.pv[half], whole.co[half])
        parts += over_time(piece, WEEK_S, 0.0)
    (first, *_), (one, *_) = joined_parts(parts), over_time(whole, WEEK_S, 0.0)
    assert first.error == pytest.approx(one.error, rel=0.05)
    assert math.isnan(next(over_time(whole, WEEK_S, 0.0, setpoint=False)).error)


def test_the_length_of_the_parts_follows_that_of_the_record() -> None:
    days = (1.9, 3.0, 13.9, 14.0, 180.0, 190.0)
    assert [period_of(n * DAY_S) for n in days] == [None, DAY_S, DAY_S, WEEK_S, WEEK_S, 4 * WEEK_S]
