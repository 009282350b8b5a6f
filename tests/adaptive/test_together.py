"""The first records of a region as one: one process whatever the unit, the gains and the time between them."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.identification.identify import FitSettings, identify_window
from retuner.adaptive.region_model import update
from retuner.adaptive.region_model.update import Agreement, TrackerSettings, update_region_model
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.state_file import region_model_in, region_model_out
from retuner.schedule.gains import PidGains

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
