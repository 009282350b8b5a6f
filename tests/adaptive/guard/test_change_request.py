"""What the guard is asked follows from what is known: models of this and of the neighbouring regions, age, locks."""

from dataclasses import replace

import numpy as np
import pytest
from guard_cases import BEST, GAINS, MODEL, times

from retuner import GainTable, Regions, RetunerSettings
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.request import KC_ONLY, NO_DERIVATIVE, NO_LOCKS
from retuner.adaptive.guard.ruling import Ruling
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.supervision.known_processes import KnownProcesses, change_request, unproved_request

REGIONS = Regions("pv", "C", ("cold", "warm", "hot"), 0.0, (20.0, 60.0), 100.0)
START = GainTable("oven", REGIONS, (GAINS, times(0.5, 0.5), times(0.3, 0.3)))
NOW = START.with_gains(1, times(0.8, 0.8))
SETTINGS = RetunerSettings(1.0, 100.0, region_locks=(None, KC_ONLY), locks=NO_DERIVATIVE)


def region_model(k: float, t_s: float = 0.0) -> RegionModel:
    model = replace(MODEL, k=k)
    log = LogModel(parameters_of(model), 0.01 * np.eye(3), 1)
    around = (Plausible(model, 0.0), Plausible(replace(model, theta_s=6.0), 3.0))
    return RegionModel((StructureModel(log, 0.0),), 3, t_s, plausible=around)


def test_a_borrowed_model_is_no_record() -> None:
    lent = replace(region_model(2.0), records=0)
    asked = change_request(BEST, 1, START, KnownProcesses(NOW, {1: lent}, 0.0, SETTINGS), None)
    assert asked.evidence.borrowed
    verdict = prove(asked, SETTINGS.guard)
    assert verdict.ruling == Ruling.TOO_FEW_RECORDS
    assert "neighbouring region" in verdict.checks[0].words
    own = change_request(BEST, 1, START, KnownProcesses(NOW, {1: region_model(2.0)}, 0.0, SETTINGS), None)
    assert not own.evidence.borrowed


def test_locks_of_the_region_come_before_those_of_the_loop() -> None:
    region_models = {i: region_model(2.0) for i in range(3)}
    found = [
        change_request(BEST, i, START, KnownProcesses(NOW, region_models, 0.0, SETTINGS), None).locks for i in range(3)
    ]
    assert found == [NO_DERIVATIVE, KC_ONLY, NO_DERIVATIVE]
    assert RetunerSettings(1.0, 100.0).locks_of(5) == NO_LOCKS


@pytest.mark.parametrize(("damping", "urgent"), [(None, False), (0.89, False), (0.9, True), (1.2, True)])
def test_a_swing_that_does_not_die_is_urgent(damping: float | None, urgent: bool) -> None:
    asked = change_request(BEST, 1, START, KnownProcesses(NOW, {1: region_model(2.0)}, 0.0, SETTINGS), None, damping)
    assert asked.urgent == urgent
    assert unproved_request(BEST, 1, (NOW, START), SETTINGS, damping).urgent == urgent
    late = replace(SETTINGS, guard=GuardSettings(urgent_damping=2.0))
    assert not change_request(
        BEST, 1, START, KnownProcesses(NOW, {1: region_model(2.0)}, 0.0, late), None, damping
    ).urgent
