"""Another schedule is proposed where a region is too wide for one set, and nowhere else."""

import json
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.region_model.proposed_borders import (
    MS_END,
    Refinement,
    best_of,
    in_force,
    place_by,
    proposed_borders,
)
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.schedule_design.places import DesignLimits, Place
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

REGIONS = Regions("pv", "degC", ("low", "middle", "high"), 0.0, (33.0, 67.0), 99.0, 1.0)
STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.02)
THETA_S, TAU_S = 8.0, 40.0
STEEP = 60.0
"""Factor of the gain from the lowest region's centre to the highest: 8 in each."""


def log_of(k: float, variance: float = 2e-4) -> LogModel:
    return LogModel(np.log([k / TAU_S, THETA_S, TAU_S]), variance * np.eye(3), 1)


def known(k: float, variance: float = 2e-4) -> RegionModel:
    return RegionModel((StructureModel(log_of(k, variance), -500.0),), 5, 0.0)


def best(k: float) -> PidGains:
    model = known(k).log.model()
    return simc(replace(model, theta_s=THETA_S + 0.5)).gains


def rising(factor: float, variance: float = 2e-4) -> dict[int, RegionModel]:
    """A gain that rises by a factor from the lowest region's centre to the highest."""
    return {i: known(factor ** (i / 2), variance) for i in range(3)}


def table_of(*gains: PidGains, regions: Regions = REGIONS, lookup: Lookup = Lookup.HARD) -> GainTable:
    return GainTable("oven", regions, gains, lookup)


def place(k: float, x: float = 0.0, variance: float = 2e-4) -> Place:
    found = place_by(x, log_of(k, variance), 1.0, DesignLimits())
    assert found is not None
    return found


@pytest.fixture(scope="module")
def one_set() -> GainTable:
    return table_of(*[best(1.0)] * 3)


@pytest.fixture(scope="module")
def found(one_set: GainTable) -> Refinement:
    proposed = proposed_borders(one_set, rising(STEEP), 0.0, 1.0, STILL)
    assert proposed is not None
    return proposed


def test_regions_in_which_the_gain_grows_eightfold_are_too_wide(one_set: GainTable, found: Refinement) -> None:
    assert found.kept < found.kept_then <= found.places
    assert found.ms_then <= MS_END
    assert found.table.revision == one_set.revision + 1
    assert {one.region for one in found.wide} <= {"low", "middle", "high"}
    assert all(one.share < one.share_then and 3 < one.kc_factor < 10 for one in found.wide)
    assert "is too wide for one set" in found.sentence
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["kind"] == "refine"


def test_what_is_proposed_serves_more_places_of_the_true_process(found: Refinement) -> None:
    def served(table: GainTable) -> int:
        xs = np.linspace(2.0, 97.0, 20).tolist()
        return sum(place(STEEP ** ((x - 16.5) / 66.5), x).keeps(in_force(table, x), DesignLimits()) for x in xs)

    centres = table_of(*(best(STEEP ** (i / 2)) for i in range(3)))
    assert served(found.table) > served(centres)


def test_the_same_values_give_the_same_proposal(one_set: GainTable, found: Refinement) -> None:
    assert proposed_borders(one_set, rising(STEEP), 0.0, 1.0, STILL) == found


@pytest.mark.parametrize("factor", [1.0, 1.8])
def test_wrong_sets_in_regions_that_one_set_can_serve_ask_for_no_other_regions(factor: float) -> None:
    assert proposed_borders(table_of(*[best(0.2)] * 3), rising(factor), 0.0, 1.0, STILL) is None


@pytest.mark.parametrize(
    "models",
    [
        {0: known(1.0)},
        {0: known(1.0), 2: replace(known(3.0), records=1)},
        rising(STEEP, 0.3),
        {i: replace(one, identifiable=False) for i, one in rising(STEEP).items()},
        {},
    ],
    ids=["one region", "too few records", "vague", "not settled", "nothing"],
)
def test_what_is_not_known_proposes_nothing(models: dict[int, RegionModel], one_set: GainTable) -> None:
    assert proposed_borders(one_set, models, 0.0, 1.0, STILL) is None


def test_age_takes_the_proposal_away(one_set: GainTable) -> None:
    walks = replace(STILL, walk_per_day=0.3)
    assert proposed_borders(one_set, rising(STEEP), 86400.0 * 9, 1.0, walks) is None


def test_a_table_that_is_interpolated_is_left_alone() -> None:
    table = table_of(*[best(1.0)] * 3, lookup=Lookup.INTERPOLATED)
    assert proposed_borders(table, rising(STEEP), 0.0, 1.0, STILL) is None


def test_no_boundary_stands_nearer_to_another_than_its_hysteresis() -> None:
    narrow = Regions("pv", "degC", ("low", "middle", "high"), 0.0, (33.0, 67.0), 99.0, 16.0)
    found = proposed_borders(table_of(*[best(1.0)] * 3, regions=narrow), rising(STEEP), 0.0, 1.0, STILL)
    assert found is None or found.table.lookup is Lookup.INTERPOLATED


def test_doubt_makes_a_place_its_own_set_calmer_until_it_has_none() -> None:
    sure, unsure = place(2.0), place(2.0, variance=1.4e-2)
    assert abs(unsure.own.kp) < abs(sure.own.kp)
    assert sure.keeps(sure.own, DesignLimits())
    assert not unsure.keeps(PidGains(*(1.3 * gain for gain in (sure.own.kp, sure.own.ki, 0.0))), DesignLimits())
    assert place_by(0.0, log_of(2.0, 8e-2), 1.0, DesignLimits()) is None


def test_the_best_set_for_places_keeps_the_limits_at_most_of_them() -> None:
    row = [place(k, x) for x, k in enumerate((1.0, 1.2, 1.4, 8.0))]
    chosen = best_of(row, DesignLimits())
    assert [one.keeps(chosen.gains, DesignLimits()) for one in row] == [True, True, True, False]
    assert chosen.kept == 3
