"""A schedule that the regions' records ask for is proposed where the table in force does not keep its limits."""

import json
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.refinement import Refinement, in_force, refinement
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

REGIONS = Regions("pv", "degC", ("low", "middle", "high"), 0.0, (33.0, 67.0), 99.0, 1.0)
STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.02)
THETA_S, TAU_S = 8.0, 40.0


def known(k: float, variance: float = 2e-4) -> RegionModel:
    log = LogModel(np.log([k / TAU_S, THETA_S, TAU_S]), variance * np.eye(3), 1)
    return RegionModel((StructureModel(log, -500.0),), 5, 0.0)


def best(k: float) -> PidGains:
    model = known(k).log.model()
    return simc(replace(model, theta_s=THETA_S + 0.5)).gains


def rising(factor: float) -> dict[int, RegionModel]:
    """A gain that rises by a factor from the lowest region's centre to the highest."""
    return {i: known(factor ** (i / 2)) for i in range(3)}


def table_of(*gains: PidGains) -> GainTable:
    return GainTable("oven", REGIONS, gains)


@pytest.fixture(scope="module")
def one_set() -> GainTable:
    return table_of(*[best(1.0)] * 3)


@pytest.fixture(scope="module")
def found(one_set: GainTable) -> Refinement:
    proposed = refinement(one_set, rising(3.0), 0.0, 1.0, STILL)
    assert proposed is not None
    return proposed


def test_one_set_for_a_gain_that_triples_is_refined(one_set: GainTable, found: Refinement) -> None:
    assert found.kept < found.kept_then <= found.places
    assert found.ms_then < found.ms
    assert found.table.revision == one_set.revision + 1
    assert abs(in_force(found.table, 85.0).kp) < abs(in_force(found.table, 15.0).kp)
    assert "Another schedule serves more places" in found.sentence
    assert json.loads(json.dumps(found.to_dict()))["kind"] == "refine"


def test_the_same_values_give_the_same_proposal(one_set: GainTable, found: Refinement) -> None:
    assert refinement(one_set, rising(3.0), 0.0, 1.0, STILL) == found


def test_a_table_that_serves_every_place_is_left_alone(one_set: GainTable) -> None:
    assert refinement(one_set, rising(1.0), 0.0, 1.0, STILL) is None


@pytest.mark.parametrize(
    "models",
    [
        {0: known(1.0)},
        {0: known(1.0), 2: replace(known(3.0), records=1)},
        {i: known(3.0 ** (i / 2), 0.3) for i in range(3)},
        {i: replace(known(3.0 ** (i / 2)), identifiable=False) for i in range(3)},
        {},
        {0: known(1.0), 1: known(3.0)},
    ],
    ids=["one region", "too few records", "vague", "not settled", "nothing", "a region that never was visited"],
)
def test_what_is_not_known_proposes_nothing(models: dict[int, RegionModel], one_set: GainTable) -> None:
    assert refinement(one_set, models, 0.0, 1.0, STILL) is None


def test_a_table_that_is_unstable_somewhere_is_told_in_words_and_in_plain_json() -> None:
    found = refinement(table_of(*[best(0.1)] * 3), rising(3.0), 0.0, 1.0, STILL)
    assert found is not None
    assert "instead of that of an unstable loop" in found.sentence
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["ms"][0] is None


def test_age_takes_the_proposal_away(one_set: GainTable) -> None:
    walks = replace(STILL, walk_per_day=0.3)
    assert refinement(one_set, rising(3.0), 86400.0 * 9, 1.0, walks) is None


def test_a_mean_of_two_sets_is_proposed_where_it_needs_fewer_than_steps(found: Refinement) -> None:
    assert found.table.lookup is Lookup.INTERPOLATED
    assert "interpolated sets about" in found.sentence
    for x in np.linspace(5.0, 94.0, 12).tolist():
        k = 3.0 ** ((x - 16.5) / 67.0)
        assert sensitivity_peak(known(k).log.model().seen_by_controller(1.0).linear(), in_force(found.table, x)) < 1.8
    level = refinement(table_of(*[best(3.0)] * 3), rising(1.0), 0.0, 1.0, STILL)
    assert level is not None
    assert (level.table.lookup, len(level.table.gains)) == (Lookup.HARD, 1)
