"""A region without evidence borrows its neighbours' model, widened; its own first record decides."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.from_neighbours import BorrowingSettings, borrowed
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import Agreement, TrackerSettings, update_region_model
from retuner.adaptive.schedule_design.record_stretches import BEND_STD, SLOPE_STD
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions

REGIONS = Regions("pv", "-", ("low", "middle", "high"), 0.0, (30.0, 70.0), 100.0)
STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.0)
LENDING = BorrowingSettings()
GAINS = PidGains(2.0, 0.05)


def known(k: float, variance: float = 1e-4, *, sign: int = 1, records: int = 3) -> RegionModel:
    log = LogModel(np.log([k / 50.0, 5.0, 50.0]), variance * np.eye(3), sign)
    slope = LogModel(np.log([k / 50.0, 5.0]), variance * np.eye(2), sign, ProcessType.INTEGRATING)
    return RegionModel((StructureModel(log, -500.0), StructureModel(slope, -100.0)), records, 0.0)


def ask(region_models: dict[int, RegionModel], region: int = 1, tracker: TrackerSettings = STILL) -> RegionModel | None:
    return borrowed(region_models, region, REGIONS, 0.0, 1, LENDING, tracker)


def test_one_neighbour_lends_its_model_as_uncertain_as_a_curve_through_it() -> None:
    found = ask({0: known(2.0)})
    assert found.records == 0
    assert "low" in found.reason
    np.testing.assert_allclose(found.log.x, known(2.0).log.x)
    between = found.log.p[0, 0]
    bent = (SLOPE_STD * 0.7) ** 2 + 4 * BEND_STD**2  # 0.7 of half the range away
    assert (SLOPE_STD * 0.7) ** 2 / 3 < between < bent  # or a line, or constant, each as likely
    np.testing.assert_allclose(found.log.p, between * np.eye(3), rtol=1e-6, atol=1e-9)
    assert [k.log.type for k in found.known] == [ProcessType.FOPDT, ProcessType.INTEGRATING]
    assert found.known[1].evidence - found.known[0].evidence == pytest.approx(LENDING.most_lead)


def test_two_neighbours_that_differ_leave_the_region_between_them_open() -> None:
    found, same = ask({0: known(1.0), 2: known(4.0)}), ask({0: known(2.0), 2: known(2.0)})
    assert same is not None
    assert found.log.model().k == pytest.approx(2.0)
    between = found.log.p[0, 0]
    assert between < ask({0: known(2.0)}).log.p[0, 0]  # between two it is known better than beside one
    assert 0.2**2 < same.log.p[0, 0] < between  # equal ones do not prove that nothing lies between them


def test_what_is_beyond_follows_the_trend_of_the_others() -> None:
    regions = replace(REGIONS, names=("a", "b", "c", "d"), bounds=(25.0, 50.0, 75.0))
    rising = {i: known(k) for i, k in enumerate((1.0, 1.5, 2.25))}
    found = borrowed(rising, 3, regions, 0.0, 1, LENDING, STILL)
    assert 2.25 * 1.2 < found.log.model().k < 2.25 * 1.6


def test_nothing_is_lent_on_credit_or_the_other_way_round() -> None:
    assert ask({0: known(2.0, records=0)}) is None
    assert ask({0: known(2.0, sign=-1)}) is None
    assert ask({0: replace(known(2.0), identifiable=False)}) is None
    assert ask({1: known(2.0)}) is None
    assert ask({}) is None


def test_records_of_its_own_that_settle_nothing_narrow_what_is_lent() -> None:
    lent = {0: known(1.0), 2: known(4.0)}
    alone = borrowed(lent, 1, REGIONS, 0.0, 1, LENDING, STILL)
    own = replace(known(3.0, 0.1), identifiable=False)
    together = borrowed(lent, 1, REGIONS, 0.0, 1, LENDING, STILL, own)
    assert alone.log.model().k < together.log.model().k < 3.0
    assert together.log.p[0, 0] < min(alone.log.p[0, 0], 0.1)


def test_age_opens_what_is_lent() -> None:
    walk = replace(STILL, walk_per_day=0.1)
    fresh = borrowed({0: known(2.0)}, 1, REGIONS, 0.0, 1, LENDING, walk)
    old = borrowed({0: known(2.0)}, 1, REGIONS, 86400.0, 1, LENDING, walk)
    more = np.diag(old.log.p) - np.diag(fresh.log.p)
    assert np.all((more > 0.005) & (more < 0.0101))


def test_the_proof_sees_the_whole_spread() -> None:
    found = ask({0: known(2.0)})
    assert found is not None
    gains = [p.model.k / p.model.tau1_s for p in found.plausible]
    assert max(gains) > 1.9 * gains[0]
    assert min(gains) < gains[0] / 1.9


def test_the_first_record_of_the_region_agrees_or_stands_alone(loop: Callable) -> None:
    prior = ask({0: known(1.3)})
    window = loop(noise=0.02, sp=1.0, kc=2.0).run(seed=1)
    agreed = update_region_model(prior, window, GAINS, STILL, FitSettings())
    assert agreed.agreement == Agreement.AGREES
    assert agreed.region_model.records == 1
    assert agreed.region_model.log.model().k == pytest.approx(1.0, rel=0.05)
    alone = update_region_model(ask({0: known(200.0, 1e-6)}), window, GAINS, STILL, FitSettings())
    assert alone.agreement == Agreement.FIRST
    assert alone.region_model.log.model().k == pytest.approx(1.0, rel=0.05)
