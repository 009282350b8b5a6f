"""Which responses may teach a region: every ground is reached, by its own fault and no other."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopMode, LoopSample, Window
from retuner.adaptive.supervision.admission import Admission, AdmissionSettings, Ground, admit, inside_region
from retuner.schedule.regions import Axis, Regions

N, AT, BAND = 120, 30, 0.02
RANGE = (-10.0, 10.0)
Samples = list[LoopSample]


def swing(sp_step: float = 1.0, noise: float = 0.0) -> Samples:
    """A decaying swing about a new setpoint from sample AT on; co goes along."""
    rows = []
    for i in range(N):
        since = i - AT
        e = sp_step * math.exp(-since / 15) * math.cos(since / 6) if since >= 0 else 0.0
        sp = sp_step if since >= 0 else 0.0
        rows.append(LoopSample(float(i), sp, sp - e + noise * (-1) ** i, 40 + 3 * e + 0.01 * i, x=sp))
    return rows


def found(samples: Samples, t_start_s: float = float(AT)) -> Response:
    return Response(t_start_s, samples[-1].t_s, (Peak(30.0, 1.0), Peak(48.0, -0.3)), Ending.QUIET, True, BAND)


def judged(samples: Samples, settings: AdmissionSettings | None = None, response: Response | None = None) -> Admission:
    return admit(Window.of(samples), samples, response or found(samples), settings or AdmissionSettings())


def changed(samples: Samples, where: range, **values: float) -> Samples:
    return [s._replace(**values) if i in where else s for i, s in enumerate(samples)]


def led(samples: Samples, every: int) -> Samples:
    return [s._replace(sp=s.sp + 0.05 * (i // every % 2)) for i, s in enumerate(samples)]


def stuck(samples: Samples) -> Samples:
    """Telemetry that repeats one sample from the upset on."""
    return [s if i < AT + 2 else samples[AT + 2]._replace(t_s=s.t_s) for i, s in enumerate(samples)]


def stood(samples: Samples, where: range, noise: float = 0.003) -> Samples:
    """A sensor with noise that gets stuck."""
    noisy = [s._replace(pv=s.pv + noise * (-1) ** i) for i, s in enumerate(samples)]
    return changed(noisy, where, pv=noisy[where[0]].pv)


FAULTS: dict[Ground, Callable[[Samples], Samples]] = {
    Ground.ADMITTED: lambda s: s,
    Ground.TOO_LONG: lambda s: s[AT + 10 :],
    Ground.MANUAL: lambda s: changed(s, range(60, 61), mode=LoopMode.MANUAL),
    Ground.OUT_OF_RANGE: lambda s: changed(s, range(60, 62), pv=1e6),
    Ground.PV_STUCK: lambda s: stood(s, range(50, 75)),
    Ground.PV_CLIPPED: lambda s: changed(stood(s, range(1)), range(50, 75), pv=RANGE[1]),
    Ground.LOST_SAMPLES: lambda s: [x for i, x in enumerate(s) if i % 6 < 3],
    Ground.IRREGULAR: lambda s: [x._replace(t_s=x.t_s + (0.8 if i % 5 == 0 else 0.0)) for i, x in enumerate(s)],
    Ground.REPEATED: stuck,
    Ground.LEFT_REGION: lambda s: changed(s, range(70, 90), x=9.0),
    Ground.GAINS_CHANGED: lambda s: changed(s, range(70, N), revision=1),
    Ground.SETPOINT_LED: lambda s: led(s, 3),
    Ground.SATURATED: lambda s: changed(s, range(N), co=100.0, limited=1),
    Ground.CO_FROZEN: lambda s: changed(s, range(N), co=40.0),
    Ground.PV_FROZEN: lambda s: changed(s, range(N), pv=0.5),
    Ground.LOW_EXCITATION: lambda s: [x._replace(sp=0.0, pv=0.042 * (x.pv - x.sp)) for x in s],
}


def test_a_setpoint_step_is_admitted_however_small_and_a_load_of_that_height_is_not() -> None:
    small = [x._replace(sp=0.03 * x.sp, pv=0.03 * x.pv) for x in swing()]
    assert judged(small).admitted
    load = [x._replace(sp=0.0, pv=x.pv - x.sp) for x in small]
    assert judged(load, response=replace(found(load), sp_changed=False)).ground is Ground.LOW_EXCITATION


@pytest.mark.parametrize("ground", Ground)
def test_every_ground_is_reached_by_its_fault(ground: Ground) -> None:
    samples = FAULTS[ground](swing())
    response = replace(found(samples), sp_changed=ground is not Ground.LOW_EXCITATION)
    admission = admit(Window.of(samples), samples, response, AdmissionSettings(), lambda s: s.x < 5, RANGE)
    assert admission.ground is ground
    assert admission.admitted == (ground is Ground.ADMITTED)
    assert "{" not in admission.sentence
    assert all(math.isfinite(value) for value in admission.numbers.to_dict().values())
    document = admission.to_dict()
    assert document["ground"] == ground.name.lower()
    assert document["reason"] == admission.sentence


def test_an_output_at_its_limit_is_a_known_input() -> None:
    assert judged(changed(swing(), range(AT, N), limited=1)).admitted


def test_late_stamps_and_every_fifth_sample_lost_are_taken() -> None:
    late = [s._replace(t_s=s.t_s + 0.3 * math.sin(1.7 * i)) for i, s in enumerate(swing()) if i % 5]
    assert judged(late).admitted


def test_a_signal_without_noise_or_in_coarse_steps_may_stand_still() -> None:
    """It does so at rest and for a dead time, and that is no fault."""
    assert judged(changed(swing(), range(AT, AT + 25), pv=0.0)).admitted
    coarse = [s._replace(pv=0.1 * round(10 * s.pv)) for s in swing()]
    assert judged(coarse).admitted
    assert judged(stood(swing(), range(50, 65))).admitted  # for shorter than is told


def test_a_sensor_that_stood_still_twice_is_stuck() -> None:
    """The other time is not what this sensor does by itself."""
    twice = changed(stood(swing(), range(35, 60)), range(75, 100), pv=0.4)
    assert judged(twice).ground is Ground.PV_STUCK


def test_a_sensor_that_stood_still_to_the_beginning_of_the_record_is_told_by_the_noise_before_it() -> None:
    samples = stood(swing(), range(AT - 10, AT + 40))
    cut = samples[AT - 10 :]
    early = [s._replace(t_s=s.t_s - 200.0) for s in stood(swing(), range(1))]
    response = found(samples, t_start_s=AT + 30)
    assert admit(Window.of(cut), [*early, *samples], response, AdmissionSettings()).ground is Ground.PV_STUCK


def test_what_happened_before_the_response_is_no_fault_of_it() -> None:
    before = changed(changed(swing(), range(10), revision=3), range(10), limited=1)
    assert judged(before).admitted


def test_gains_that_follow_an_interpolated_table_may_be_allowed() -> None:
    samples = [s._replace(revision=i // 10) for i, s in enumerate(swing())]
    assert judged(samples).ground is Ground.GAINS_CHANGED
    assert judged(samples, AdmissionSettings(changes_most=100)).admitted


def test_a_region_ends_at_its_boundaries_widened_by_the_hysteresis() -> None:
    regions = Regions("pv", "-", ("low", "middle", "high"), 0.0, (10.0, 20.0), 30.0, 2.0)
    sample = swing()[0]
    for region, inside, outside in ((0, (-50, 0, 12), (12.1,)), (1, (8, 15, 22), (7.9, 22.1)), (2, (18, 99), (17.9,))):
        test = inside_region(regions, region)
        assert all(test(sample._replace(x=x)) for x in inside)
        assert not any(test(sample._replace(x=x)) for x in outside)
        assert test(sample._replace(x=math.nan))


def test_a_cell_ends_on_both_axes() -> None:
    first, second = Axis("pv", "-", 0.0, (10.0,), 30.0, 2.0), Axis("co", "%", 0.0, (50.0,), 100.0, 5.0)
    test = inside_region(Regions.along(("a", "b", "c", "d"), first, second), 1)
    sample = swing()[0]
    assert test(sample._replace(x=11.9, x2=45.1))
    assert not test(sample._replace(x=11.9, x2=44.9))
    assert not test(sample._replace(x=12.1, x2=60.0))


def test_noise_on_the_scheduling_variable_is_no_absence() -> None:
    samples = changed(swing(), range(70, 73), x=9.0)
    assert admit(Window.of(samples), samples, found(samples), AdmissionSettings(), lambda s: s.x < 5).admitted


def test_a_ramp_and_two_steps_of_the_setpoint_are_a_persons() -> None:
    ramp = [s._replace(sp=min(max(i - AT, 0), 20) / 20) for i, s in enumerate(swing())]
    assert judged(ramp).admitted
    twice = [s._replace(sp=s.sp * (1 + (i > 80))) for i, s in enumerate(swing())]
    assert judged(twice).admitted


def test_a_setpoint_that_trembles_less_than_the_noise_stands_still() -> None:
    samples = [s._replace(sp=s.sp + 1e-5 * (-1) ** i) for i, s in enumerate(swing())]
    assert judged(samples).admitted


def test_a_coarse_measurement_is_no_repetition_as_long_as_co_moves() -> None:
    samples = [s._replace(pv=round(s.pv * 5) / 5) for s in swing()]
    assert judged(samples).admitted


def test_a_coarse_output_is_no_repetition_where_integral_action_moves_it_by_less_than_a_count() -> None:
    still = [s._replace(pv=s.sp - 0.5, co=40.0 + 0.2 * (i // 10)) for i, s in enumerate(swing())]
    for ki, ground in ((0.04, Ground.ADMITTED), (0.0, Ground.ADMITTED), (0.8, Ground.REPEATED)):
        given = admit(Window.of(still), still, found(still), AdmissionSettings(), ki=ki)
        assert given.ground is ground


def test_a_window_that_was_not_made_of_these_samples_is_refused() -> None:
    samples = swing()
    with pytest.raises(ValueError, match="cannot have been made"):
        admit(Window.of(samples), samples[:50], found(samples), AdmissionSettings())


@given(first=st.integers(0, N - 1), length=st.integers(1, N), limit=st.floats(0.05, 0.9))
def test_saturation_counts_by_its_share_of_the_response(first: int, length: int, limit: float) -> None:
    samples = changed(swing(), range(first, first + length), limited=-1)
    share = sum(1 for s in samples[AT:] if s.limited) / (N - AT)
    admission = judged(samples, AdmissionSettings(limited_share=limit))
    assert (admission.ground is Ground.SATURATED) == (share > limit)
    assert admission.numbers.limited_share == pytest.approx(share)


@given(size=st.floats(0.001, 100), shift=st.floats(-1e3, 1e3))
def test_height_counts_in_noise_bands_whatever_the_unit(size: float, shift: float) -> None:
    samples = [s._replace(sp=s.sp * size + shift, pv=s.pv * size + shift) for s in swing()]
    response = replace(found(samples), band=0.3 * size)
    assert judged(samples, response=response).numbers.peak_bands == pytest.approx(1 / 0.3, rel=1e-6)


@given(at=st.integers(0, N - 1))
def test_one_sample_in_manual_is_enough(at: int) -> None:
    assert judged(changed(swing(), range(at, at + 1), mode=LoopMode.MANUAL)).ground is Ground.MANUAL


def test_pv_may_stand_a_little_outside_its_range() -> None:
    samples = swing()  # up to 1.307
    narrow = (-1.0, 1.2)
    assert admit(Window.of(samples), samples, found(samples), AdmissionSettings(), pv_range=narrow).admitted
    swings_on = replace(found(samples), peaks=(Peak(30.0, 1.0), Peak(48.0, -1.0)))  # nothing but a fit ends that
    for response, is_admitted in ((found(samples), False), (swings_on, True)):
        admission = admit(Window.of(samples), samples, response, AdmissionSettings(), pv_range=(-0.1, 0.9))
        assert admission.admitted is is_admitted
    samples = changed(samples, range(61, 62), pv=-1.4)
    admission = admit(Window.of(samples), samples, swings_on, AdmissionSettings(), pv_range=narrow)
    said = "pv reached -1.4, far outside its range of -1 to 1.2: a sensor or scaling error, or a loop out of control"
    assert admission.sentence == said
