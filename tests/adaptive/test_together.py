"""The first records of a region as one: one process whatever the unit, the gains and the time between them."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from retuner import PidGains, ProcessType, Regions
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.identify import FitSettings, identify_window
from retuner.adaptive.region_model import update
from retuner.adaptive.region_model.from_neighbours import BorrowingSettings, borrowed
from retuner.adaptive.region_model.kalman import back_to_mean, widened
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel
from retuner.adaptive.region_model.steady_drift import moved, told
from retuner.adaptive.region_model.update import Agreement, TrackerSettings, predicted, update_region_model
from retuner.adaptive.schedule_design.record_stretches import BEND_STD, SLOPE_STD
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out

FIT, UP = FitSettings(), PidGains(2.0, 0.05)
TRUTH = {"k": 1.0, "tau1": 50.0, "theta": 5.0}


def two(loop: Callable, load: float = 3.0) -> list[Window]:
    """A setpoint step, and a load an hour later."""
    shapes = ({"sp": 1.0}, {"load": load})
    return [loop(noise=0.02, **shape).run(seed=i, t0=3600.0 * i) for i, shape in enumerate(shapes)]


def in_unit(window: Window, unit: float) -> Window:
    return Window(window.t_s, window.sp * unit, window.pv * unit, window.co * unit, window.noise_std * unit)


def test_two_records_of_one_process_are_one_record_of_it(loop: Callable) -> None:
    model = identify_window(update.joined(two(loop)), 1, None, FIT).log.model().to_dict()
    assert {name: model[name] for name in TRUTH} == pytest.approx(TRUTH, rel=0.05)


def test_the_unit_of_a_record_does_not_matter(loop: Callable) -> None:
    first, second = two(loop)
    plain, other = (update.joined([first, record]) for record in (second, in_unit(second, 1000.0)))
    np.testing.assert_allclose(other.pv, plain.pv, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(other.co, plain.co, rtol=1e-9, atol=1e-9)


def test_what_a_later_record_repeats_is_left_out(loop: Callable) -> None:
    whole = two(loop)[0]
    half = len(whole.t_s) // 2
    one = update.joined([whole.part(slice(0, half + 20)), whole.part(slice(half - 20, None))])
    assert len(one.t_s) == len(whole.t_s)
    assert np.max(np.diff(one.t_s)) == pytest.approx(update.GAP_SAMPLES * whole.sample_time_s)


def test_a_long_record_is_kept_in_few_samples(loop: Callable) -> None:
    record = two(loop)[0]
    t_s = record.t_s[0] + record.sample_time_s * np.arange(3000)
    long = Window(t_s, *(np.resize(values, 3000) for values in (record.sp, record.pv, record.co)))
    short = update.kept(long)
    assert len(short.t_s) <= update.MOST_SAMPLES
    assert short.sample_time_s == pytest.approx(4 * record.sample_time_s)


@pytest.mark.parametrize(("samples", "later", "enough"), [(700, 64, True), (3100, 64, False), (6100, 24, False)])
def test_of_a_short_record_beside_a_long_one_enough_must_be_left(samples: int, later: int, enough: bool) -> None:
    long, short = (
        update.kept(Window(t_s, 0.0 * t_s, np.sin(t_s / 9.0), 0.0 * t_s))
        for t_s in (np.arange(samples, dtype=float), 1e5 + np.arange(later, dtype=float))
    )
    assert update.may_be_joined((long, short)) is enough


def test_a_short_record_after_a_very_long_one_is_taken_in_by_itself(loop: Callable) -> None:
    first, second = two(loop, load=1.0)
    strict = FitSettings(gain_std_limit=0.03)
    begun = update_region_model(None, first, UP, TrackerSettings(), strict).region_model
    assert begun is not None
    t_s = first.t_s[0] + 64.0 * np.arange(len(first.t_s))
    slow = replace(begun, windows=(Window(t_s, first.sp, first.pv, first.co),))
    learned = update_region_model(slow, second, UP, TrackerSettings(), strict).region_model
    assert learned is None or len(learned.windows) < 2


def test_a_pv_that_never_moved_has_a_unit() -> None:
    t_s = np.arange(40.0)
    still = Window(t_s, 0.0 * t_s, 5.0 + 0.0 * t_s, 0.0 * t_s)
    assert np.all(np.isfinite(update.joined([still, still]).pv))


def test_a_record_that_settles_nothing_alone_is_fitted_with_the_first(loop: Callable) -> None:
    """A small load says too little; with the step before it enough is said, and the memory brings it back alike."""
    first, second = two(loop, load=1.0)
    strict = FitSettings(gain_std_limit=0.03)
    begun = update_region_model(None, first, UP, TrackerSettings(), strict).region_model
    assert len(begun.windows) == 1
    alone = identify_window(second, 1, None, strict)
    assert not alone.identifiable
    kept = region_model_in(json.loads(json.dumps(region_model_out(begun))))
    learned, again = (update_region_model(known, second, UP, TrackerSettings(), strict) for known in (begun, kept))
    assert learned.agreement is again.agreement is Agreement.AGREES
    np.testing.assert_array_equal(learned.region_model.log.x, again.region_model.log.x)
    assert len(learned.region_model.windows) == 2  # fitted as one, not folded into the other


# A region without evidence borrows its neighbours' model, widened; its own first record decides.


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


# What is known of a process that moves in one direction: a drift is a hypothesis with its odds.


D = 3
WALK, SEEN = 0.03, 0.04
"""Standard deviations of the walk and of a record."""
BEGIN = StructureModel(LogModel(np.array([-4.0, 1.6, 3.9]), 0.06**2 * np.eye(D), 1), 0.0)


def test_without_scatter_it_is_the_filter_of_the_textbooks() -> None:
    """A random walk, of which each record shows where it is."""
    rng, known = np.random.default_rng(3), BEGIN.log
    book = KalmanFilter(dim_x=D, dim_z=D)
    book.x, book.P = known.x.reshape(D, 1), known.p.copy()
    book.F, book.H, book.Q = np.eye(D), np.eye(D), WALK**2 * np.eye(D)
    for _ in range(12):
        seen = known.x + rng.normal(0.0, 0.1, D)
        book.predict()
        book.update(seen.reshape(D, 1), R=SEEN**2 * np.eye(D))
        prior = widened(known, WALK**2)
        gain = prior.p @ np.linalg.inv(prior.p + SEEN**2 * np.eye(D))
        posterior = replace(prior, x=prior.x + gain @ (seen - prior.x), p=prior.p - gain @ prior.p)
        (value, variance), *_ = told(prior, posterior, 0.0)
        assert (value, variance) == pytest.approx((seen[0], SEEN**2)), "what the record said is had back from both"
        known = back_to_mean(prior, prior, posterior)
    np.testing.assert_allclose(known.x, book.x[:, 0], atol=1e-9)
    np.testing.assert_allclose(known.p, book.P, atol=1e-9)


def moving(slopes: FloatArray, places: FloatArray | None = None) -> RegionModel:
    """A region whose records, 100 s apart, said these slopes; the filter is 0.09 behind the last one."""
    known = replace(BEGIN, log=replace(BEGIN.log, x=np.array([slopes[-1] - 0.09, 1.6, 3.9])))
    at = np.zeros(len(slopes)) if places is None else places
    said = zip(at, slopes, strict=True)
    points = [RecordPoint(100.0 * i, x, 0.0, known.log, 0.0, told=((y, 0.06**2),)) for i, (x, y) in enumerate(said)]
    return RegionModel((known,), len(points), points[-1].t_s, points=tuple(points))


def test_records_that_all_lie_on_one_side_show_a_drift_which_goes_on() -> None:
    """Unlike ours, drift_slow 12503: each of ten records moved the model by a part, Ms 1.77 was said, 2.36 true."""
    settings, steadily = TrackerSettings(), -4.0 + 0.08 * np.arange(8)
    model = moving(steadily)
    now, later = (predicted(model, model.t_s + 100.0 * n, settings).x[0] for n in (0, 2))
    assert now == pytest.approx(steadily[-1] + 0.08, abs=0.03), "as it is met with the next record"
    assert later == pytest.approx(steadily[-1] + 0.16, abs=0.05), "a drift goes on in time"
    assert predicted(region_model_in(region_model_out(model)), model.t_s, settings).x[0] == now

    def ahead(model: RegionModel) -> float:
        one = moved(model.known[0], model, 0.0, 0.03, ahead=True)
        return float(one.log.x[0] - model.known[0].log.x[0])

    assert ahead(moving(-4.0 + 0.06 * np.random.default_rng(1).standard_normal(8))) < 0.03, "on both sides: chance"
    assert ahead(moving(steadily[:3])) == 0.0, "three cannot tell"
    assert ahead(moving(steadily, 10.0 * np.arange(8))) < 0.03, "that may be the place"
    assert ahead(replace(model, records=3)) == 0.0, "before was another process"
    unsure = tuple(replace(point, told=((point.told[0][0], 0.2**2),)) for point in model.points)
    assert ahead(replace(model, points=unsure)) == 0.0, "what says next to nothing shows no drift"
