"""One record beside many: how probable it is that it is odd, and what that does to a choice."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.choice.expected_cost import Choosable, LoopSettings, Outlook, Seen, choose, outlooks
from retuner.adaptive.choice.odd_record import by_odds, oddness
from retuner.adaptive.choice.settings import ChoiceSettings
from retuner.adaptive.fit.structure import THETA
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

SETTINGS = ChoiceSettings()
QUIET = [0.5, 0.3, 0.9, 0.4, 1.1, 0.2]
"""Innovations of a loop in which setpoint steps come back alike (harm in saturation, seed 9531)."""


@given(st.floats(0.0, 60.0), st.floats(0.0, 60.0), st.lists(st.floats(0.01, 30.0), max_size=12), st.integers(2, 5))
def test_the_farther_a_record_lies_the_odder_it_is_and_never_surely(
    one: float, other: float, before: list[float], freedom: int
) -> None:
    near, far = (oddness(x, before, freedom, SETTINGS) for x in sorted((one, other)))
    assert 0.0 <= near <= far <= SETTINGS.odd_most


def test_a_record_as_foretold_is_not_odd_and_records_that_came_back_alike_make_another_one_odd() -> None:
    assert oddness(4.0, [], 4, SETTINGS) < 0.02
    assert oddness(12.1, [], 4, SETTINGS) < 0.3
    assert oddness(12.1, QUIET, 4, SETTINGS) > 0.75


def test_odd_records_before_do_not_hide_the_next_one() -> None:
    assert oddness(31.0, [*QUIET, 28.0, 21.0, 16.0], 4, SETTINGS) == pytest.approx(SETTINGS.odd_most, abs=0.01)


def look(cost: float) -> Outlook:
    return Outlook(cost, 0.0, math.exp(cost), 1.6, 1.8)


def test_what_only_an_odd_record_asks_for_waits_for_another_one_and_says_so() -> None:
    now, before = [look(0.35), look(0.0)], [look(0.0), look(0.07)]
    seen = Seen(14, 6, odd=0.8)
    choice = choose(by_odds(now, before, seen.odd), None, seen, SETTINGS, now)
    assert choice.index == 0
    assert choice.waits
    assert choice.numbers.odd == 0.8
    assert "80 % that this record is odd" in choice.reason
    assert choose(by_odds(now, now, seen.odd), None, seen, SETTINGS, now).index == 1
    assert choose(now, None, replace(seen, odd=0.0), SETTINGS).index == 1


def test_a_danger_that_may_be_a_changed_process_is_not_waited_out() -> None:
    choice = choose(by_odds([look(2.3), look(0.0)], [look(0.0), look(0.1)], 0.8), None, Seen(9, 3, odd=0.8), SETTINGS)
    assert choice.index == 1


def test_loads_alone_leave_more_room_below_the_limit_and_beyond_it() -> None:
    process = ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0)
    sets = [Choosable(PidGains(4.0, 0.08)), Choosable(PidGains(5.5, 0.11))]
    loop, models = LoopSettings(0.0), [Plausible(process, 0.0)]
    sure, by_loads = (outlooks(models, sets, None, loop, s) for s in (SETTINGS, SETTINGS.by_loads()))
    assert [one.ms for one in sure] == [one.ms for one in by_loads]
    assert by_loads[0].cost - by_loads[1].cost < sure[0].cost - sure[1].cost


def loads_alone(seed: int) -> Window:
    """PI on five equal lags of 1 s, a load step: no dead time can be told from the load's own time."""
    rng, dt, n = np.random.default_rng(seed), 0.6, 76
    x, integral = np.zeros(5), 0.0
    pv, co = np.zeros(n), np.zeros(n)
    for i in range(n):
        pv[i] = x[-1] + 0.006 * rng.standard_normal()
        integral -= 0.12 * dt * pv[i]
        co[i] = -0.5 * pv[i] + integral
        for _ in range(60):
            x = x + dt / 60 * (np.concatenate([[co[i] + (i >= 25)], x[:-1]]) - x)
    return Window(dt * np.arange(float(n)), np.zeros(n), pv, co)


def test_a_dead_time_at_its_least_is_not_known_to_a_few_percent() -> None:
    alternatives = identify_window(loads_alone(3), sign=1).alternatives
    third = next(a.log for a in alternatives if a.log.type is ProcessType.TOPDT)
    assert math.exp(third.x[THETA]) < 0.1
    assert math.sqrt(float(third.p[THETA, THETA])) > 1.0
