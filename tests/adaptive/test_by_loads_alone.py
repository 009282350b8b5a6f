"""What loads alone do not tell: the width of Ms, and a dead time at its least."""

import math

import numpy as np

from retuner.adaptive.choice.choice_settings import ChoiceSettings
from retuner.adaptive.choice.expected_cost import Choosable, LoopSettings, outlooks
from retuner.adaptive.fit.structure import THETA
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

SETTINGS = ChoiceSettings()


def test_loads_alone_leave_more_room_below_the_limit_and_beyond_it() -> None:
    process = ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0)
    sets = [Choosable(PidGains(4.0, 0.08)), Choosable(PidGains(5.5, 0.11))]
    loop, models = LoopSettings(0.0), [Plausible(process, 0.0)]
    sure, by_loads = (outlooks(models, sets, None, loop, s) for s in (SETTINGS, SETTINGS.by_loads()))
    assert [one.ms for one in sure] == [one.ms for one in by_loads]
    assert by_loads[0].cost - by_loads[1].cost < sure[0].cost - sure[1].cost


def test_a_dead_time_at_its_least_is_not_known_to_a_few_percent() -> None:
    rng, dt, n = np.random.default_rng(3), 0.6, 76
    x, integral = np.zeros(5), 0.0
    pv, co = np.zeros(n), np.zeros(n)
    for i in range(n):
        pv[i] = x[-1] + 0.006 * rng.standard_normal()
        integral -= 0.12 * dt * pv[i]
        co[i] = -0.5 * pv[i] + integral
        for _ in range(60):
            x = x + dt / 60 * (np.concatenate([[co[i] + (i >= 25)], x[:-1]]) - x)
    alternatives = identify_window(Window(dt * np.arange(float(n)), np.zeros(n), pv, co), sign=1).alternatives
    third = next(a.log for a in alternatives if a.log.type is ProcessType.TOPDT)
    assert math.exp(third.x[THETA]) < 0.1
    assert math.sqrt(float(third.p[THETA, THETA])) > 1.0
