"""What outvotes the odds for a valve, and what does not: a gain along pv, and a load that repeats."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from retuner.adaptive.cause_odds import odds, valve_evidence
from retuner.adaptive.cause_odds.odds import Walk
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.cause_odds.valve_evidence import shapes_of
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict
from retuner.adaptive.explanations.gain_along_pv import GainAlongPv
from retuner.adaptive.explanations.valve_odds import WEIGHT
from retuner.adaptive.explanations.wandering_load import Prepared


def test_where_pv_stands_while_co_travels_the_gain_does_not_bend() -> None:
    settings = OddsSettings()
    along, record = GainAlongPv(20.0, 5.0, 0.0, 1.0), Prepared(np.zeros(1), np.zeros(1), 0.0, 1.0)
    walk = Walk(np.zeros(1), -1.0, along, record, np.zeros(1), 0.9)
    free, stands = (odds._under_walk(walk, None, math.log(x), settings)[0] for x in (1.0, settings.stands))
    assert max(free, key=free.__getitem__) == Cause.NONLINEAR
    assert stands[Cause.STICTION] > stands[Cause.NONLINEAR]


@pytest.mark.parametrize(("left", "says"), [(1.0, True), (4.0, False)])
def test_a_fitted_valve_that_leaves_far_less_outvotes_the_valves_of_the_grid(left: float, says: bool) -> None:
    evidence = {"linear_left": 9.0, "external_left": 5.0, "stuck_left": left}
    told = RecordVerdict(Diagnosis(Cause.STICTION, 0.83, evidence, "a valve"))
    settings = OddsSettings()
    assert valve_evidence._fits(told) is says
    assert shapes_of(told, settings) == math.log(settings.valve_fits if says else settings.shapes_say)


def test_a_load_that_repeats_is_a_rival_of_the_valve_and_of_a_robust_loop_alone() -> None:
    """And what is not asked where loads are steps, whether the gain bends, is no rival of these."""
    settings = OddsSettings()
    along, record = GainAlongPv(3.0, 5.0, 0.0, 1.0), Prepared(np.zeros(1), np.zeros(1), 0.0, 1.0)
    walk = Walk(np.zeros(1), 4.0 * WEIGHT, along, record, np.zeros(1), 0.9, 4.0, 60.0)
    by_tightness = []
    for tight in (0.0, 0.9):
        classes = {"ok": 1.0 - tight, "aggressive": tight, "slow_integrating": 0.0, "sluggish": 0.0}
        of_loop: Any = SimpleNamespace(classes=classes)
        by_tightness.append(odds._under_walk(walk, of_loop, 0.0, settings))
    (found, rivals), (tight_one, _) = by_tightness
    assert found[Cause.STICTION] > found[Cause.EXTERNAL] > 0.1  # as likely as the valve, and rarer
    assert tight_one[Cause.EXTERNAL] < 0.2 * found[Cause.EXTERNAL] < tight_one[Cause.AGGRESSIVE]
    of_loop.classes |= {"ok": 0.6, "sluggish": 0.4, "aggressive": 0.0}
    alone, beside = (odds._under_walk(walk, of_loop, 0.0, settings, tone)[0] for tone in (0.0, 1.0))
    assert beside[Cause.OK] == 0.0  # what swings on and on beside setpoint steps is no loop in order
    assert beside[Cause.EXTERNAL] == pytest.approx(alone[Cause.EXTERNAL] + alone[Cause.OK])
    assert beside[Cause.SLUGGISH] == alone[Cause.SLUGGISH]
    straight = replace(walk, along=GainAlongPv(-3.0, 5.0, 0.0, 1.0))
    assert odds._under_walk(straight, None, 0.0, settings)[1] == pytest.approx(rivals)


@pytest.mark.parametrize(("degree", "cause"), [(0.5, Cause.UNKNOWN), (2.0, Cause.STICTION)])
def test_a_verdict_that_stands_by_itself_goes_by_how_far_pv_stands(degree: float, cause: Cause) -> None:
    told = RecordVerdict(Diagnosis(Cause.UNKNOWN, 0.6, {"stand_degree": degree}, "pv stands"))
    found = odds._alone(told, OddsSettings()).diagnosis
    assert found.cause is cause
    assert sum((found.causes or {}).values()) == pytest.approx(1.0)
    assert max(found.causes, key=found.causes.__getitem__) == cause
    assert found.causes["stiction"] > 0.25  # the prior is the least that a pv that stands in part leaves


def test_a_pv_that_stands_in_part_counts_by_the_square() -> None:
    settings = OddsSettings()
    half, whole, slips = (
        shapes_of(RecordVerdict(Diagnosis(Cause.UNKNOWN, 0.6, {"stand_degree": x}, "")), settings)
        for x in (0.5, 1.0, 2.0)
    )
    assert half == pytest.approx(whole / 4)
    assert (whole, slips) == pytest.approx((math.log(settings.stands), math.log(settings.stands_slips)))
