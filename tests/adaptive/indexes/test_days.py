"""A record of several days is several records: nights without samples or without control are none of the loop."""

import numpy as np
import pytest

from retuner.adaptive.indexes.days import MOST_DAYS, at_gaps, days_of
from retuner.adaptive.signals.sample import Window

DAY, NIGHT = 200, 160


def record(rng: np.random.Generator, days: int, *, off: float | None = None, push: float = 5.0) -> Window:
    """Days under control and nights with co at `off`, or without samples. push : the error of a night."""
    t, sp, pv, co, now = [], [], [], [], 0.0
    for _ in range(days):
        e = np.cumsum(rng.normal(size=DAY)) * 0.1
        t.append(now + np.arange(DAY))
        sp.append(np.full(DAY, 20.0))
        pv.append(20.0 - e)
        co.append(40.0 + 3.0 * e)
        if off is not None:
            t.append(now + DAY + np.arange(NIGHT))
            sp.append(np.full(NIGHT, 20.0))
            pv.append(20.0 - push + 0.1 * rng.normal(size=NIGHT))
            co.append(np.full(NIGHT, off))
        now += DAY + NIGHT
    return Window(*(60.0 * np.concatenate(t), *(np.concatenate(x) for x in (sp, pv, co))))


@pytest.mark.parametrize("off", [None, 0.0])
def test_each_day_is_a_record(rng: np.random.Generator, off: float | None) -> None:
    """Four days in one file with the nights off were one record "in manual"."""
    whole = record(rng, 4, off=off)
    days = days_of(whole)
    assert [len(day.t_s) for day in days] == [DAY] * 4
    assert all(len(set(day.co)) > DAY // 2 for day in days)
    assert len(days_of(record(rng, MOST_DAYS + 3, off=off))) == MOST_DAYS


def test_time_at_a_limit_is_work(rng: np.random.Generator) -> None:
    """The error pushes co against it: that is saturation, and stays in the record."""
    whole = record(rng, 4, off=90.0)
    assert days_of(whole) == [whole]


def test_one_day_and_one_quiet_spell_stay_one_record(rng: np.random.Generator) -> None:
    one = record(rng, 1, off=0.0)
    assert days_of(one) == [one]
    held = one.co.copy()
    held[50:70] = held[50]
    spell = Window(one.t_s, one.sp, one.pv, held)
    assert days_of(spell) == [spell]


def test_gaps_cut_a_record_and_leave_nothing_out(rng: np.random.Generator) -> None:
    assert at_gaps(record(rng, 3)) == [slice(0, DAY), slice(DAY, 2 * DAY), slice(2 * DAY, 3 * DAY)]
    whole = record(rng, 2, off=0.0)
    assert at_gaps(whole) == [slice(0, len(whole.t_s))]  # it stands still there: a test in manual does as well
    short = whole.part(slice(0, DAY + 30))
    late = Window(np.where(np.arange(DAY + 30) < DAY, short.t_s, short.t_s + 1e6), short.sp, short.pv, short.co)
    assert at_gaps(late) == [slice(0, DAY + 30)]
