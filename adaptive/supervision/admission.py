"""Whether a response may teach its region anything: the rules of admission, in the order in which they are asked.

    kept whole, in automatic, pv in its range, telemetry complete and even, the sensor not stuck, inside the region,
    gains unchanged, setpoint not led by another loop, output free, something moves, and it rises well above the noise

A record that is not admitted is not a weak record but a wrong one: the fit would believe it. What is only weak is
admitted, because the fit weighs it. Learning stops likewise in commercial products when a loop saturates, is not in
control or its variable left the state being learned; what happens without such rules, users of thermostats report
(one night in frost mode spoils a winter of learning).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from itertools import chain, pairwise

import numpy as np
import numpy.typing as npt

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.signals.recogniser import SWINGS_ON
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import EVERYWHERE, LoopMode, LoopSample, Window, stood_still
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values
from retuner.schedule.regions import Regions

RANGE_ROOM = 0.1
"""Share of the transmitter's range by which pv may stand outside of it: ranges are rounded, sensors reach further."""
JUMPS = 0.5  # largest share of its span that pv passes from one sample to the next in a swing: a fault does so at once

AT_END = 1e-3
"""Share of the range by which pv may be off its end and count as clipped there: converters end a count before it."""


class Ground(StrEnum):
    """Grounds for admitting a response or not; the value is the sentence, with its numbers by name."""

    ADMITTED = "admitted: {peak_bands:.1f} noise bands high, inside its region"
    TOO_LONG = "the response is longer than the {kept:.0f} samples kept: its beginning is missing"
    MANUAL = "{manual:.0f} samples of the response are in manual, without control"
    OUT_OF_RANGE = (
        "pv reached {pv_worst:g}, far outside its range of {pv_low:g} to {pv_high:g}: a sensor or scaling error, or a "
        "loop out of control"
    )
    PV_STUCK = (
        "pv stood at exactly {stuck_at:g} for {stuck:.0f} samples, without its noise: a sensor or a signal that is "
        "stuck"
    )
    PV_CLIPPED = (
        "pv stood at {stuck_at:g}, the end of its range, for {stuck:.0f} samples: where it really was is not known"
    )
    LOST_SAMPLES = "{lost_share:.0%} of the samples were lost (limit {limit:.0%})"
    IRREGULAR = "{uneven_share:.0%} of the samples came at uneven times (limit {limit:.0%})"
    REPEATED = "{repeated_share:.0%} of the samples repeat the one before them exactly (limit {limit:.0%})"
    LEFT_REGION = (
        "the scheduling variable was outside the region for {outside_share:.0%} of the samples (limit {limit:.0%})"
    )
    GAINS_CHANGED = "the gains changed during the response (changes: {changes:.0f}, limit {limit:.0f})"
    SETPOINT_LED = (
        "a cascade or a ramp moves the setpoint: at {moving_share:.0%} of the samples (limit {limit_share:.0%}), "
        "movements: {moves:.0f} (limit {limit:.0f})"
    )
    SATURATED = (
        "the controller output was at a limit for {limited_share:.0%} of the response (the model is updated below "
        "{limit:.0%})"
    )
    CO_FROZEN = "co does not move: no information for the model"
    PV_FROZEN = "pv does not move: no information for the model"
    LOW_EXCITATION = (
        "the response is too small to update the model: {peak_bands:.4g} noise bands high, {limit:g} needed"
    )


@dataclass(frozen=True, slots=True)
class AdmissionSettings:
    """What a response may lack and still teach its region."""

    limited_share: float = setting(
        1.0,
        "Largest share of a response with the output at a limit",
        "0..1",
        "a fit takes co as it was applied, at a limit or not; only what never moves shows nothing",
    )
    lost_share: float = setting(
        0.35, "Largest share of lost samples", "0..0.5", "a fit takes each sample at its own time"
    )
    uneven: float = setting(
        0.65,
        "Share of the median by which an interval is off that no late stamp makes: samples came in bursts",
        "0.1..1",
        "stamps off by 30 % make intervals off by 60 %",
    )
    uneven_share: float = setting(0.1, "Largest share of samples at uneven times", "0..1", "one in ten")
    repeated_share: float = setting(
        0.2,
        "Largest share of samples that repeat the one before although the error is outside the noise band",
        "0..1",
        "integral action moves co at every such sample",
    )
    outside_share: float = setting(
        0.05, "Largest share of samples outside the region", "0..0.5", "noise of a measured variable"
    )
    moves_most: int = setting(
        4,
        "Movements of the setpoint in one response that are still an operator's",
        "1..20 moves",
        "a cascade's master moves it all the time",
    )
    moving_share: float = setting(
        0.3,
        "Largest share of samples at which the setpoint moves",
        "0..1",
        "a ramp is one movement, and shorter than the response",
    )
    led_again_s: float = setting(
        21600.0, "Time until it is said again that the setpoint is led; such responses are counted", "0.. s"
    )
    still_share: float = setting(0.01, "A setpoint that moves by less of the noise band stands still")
    changes_most: int = setting(0, "Most changes of the active gains during a response")
    excitation_bands: float = setting(
        2.2,
        "Least height of a response in noise bands",
        "2..10",
        "the recogniser starts at 2; weaker ones are weighed by the fit",
    )

    def __post_init__(self) -> None:
        require_in_range(self, "admission")


@dataclass(frozen=True, slots=True)
class AdmissionNumbers(Numbers):
    """What the rules counted, as far as they were asked.

    kept : samples that are kept. manual : of them in manual. lost_share, uneven_share, repeated_share, outside_share :
    of the samples. changes : of the gains. moves, moving_share : of the setpoint. limited_share : of the response, with
    the output at a limit. pv_worst : pv farthest outside its range, pv_low to pv_high. stuck : samples for
    which pv stood still, at stuck_at. peak_bands : height in noise bands. passed_over : responses to a led
    setpoint since that was last said. limit, limit_share : of the rule that refused it.
    """

    kept: float | None = None
    manual: float | None = None
    lost_share: float | None = None
    uneven_share: float | None = None
    repeated_share: float | None = None
    outside_share: float | None = None
    changes: float | None = None
    moves: float | None = None
    moving_share: float | None = None
    limited_share: float | None = None
    pv_worst: float | None = None
    pv_low: float | None = None
    pv_high: float | None = None
    stuck: float | None = None
    stuck_at: float | None = None
    peak_bands: float | None = None
    passed_over: float | None = None
    limit: float | None = None
    limit_share: float | None = None


@dataclass(frozen=True, slots=True)
class Admission:
    """The outcome: the ground, and the numbers that led to it (the limit among them)."""

    ground: Ground
    numbers: AdmissionNumbers

    @property
    def admitted(self) -> bool:
        """Whether the response may teach its region."""
        return self.ground is Ground.ADMITTED

    @property
    def sentence(self) -> str:
        """The ground in words, with its numbers."""
        return self.ground.value.format(**self.numbers.to_dict())

    def diagnosis(self) -> Diagnosis:
        """A refusal as a cause: saturation has a name there, a response in the noise too, the others are unknown."""
        causes = {Ground.SATURATED: Cause.SATURATION, Ground.LOW_EXCITATION: Cause.NOISE}
        return Diagnosis(causes.get(self.ground, Cause.UNKNOWN), 1.0, self.numbers.to_dict(), self.sentence)

    def to_dict(self) -> dict[str, object]:
        """Keys admitted, ground, numbers, reason."""
        ground = self.ground.name.lower()
        return {"admitted": self.admitted, "ground": ground, **plain_values(self, "numbers reason=sentence")}


def inside_region(regions: Regions, region: int) -> Callable[[LoopSample], bool]:
    """A test whether a sample lies in a region: between its boundaries widened by their hysteresis.

    A scheduling variable that is not finite (a failed sensor) leaves the loop where it is, so it counts as inside.

    Raises ValueError: there is no such region.
    """
    laws = [(axis.law(), part) for axis, part in zip(regions.axes, regions.cell(region), strict=True)]
    limits = [(law.floors[part], law.ceilings[part]) for law, part in laws]

    def inside(sample: LoopSample) -> bool:
        return not any(x < low or x > high for x, (low, high) in zip((sample.x, sample.x2), limits, strict=False))

    return inside


def admit(
    window: Window,
    samples: Sequence[LoopSample],
    response: Response,
    settings: AdmissionSettings,
    inside: Callable[[LoopSample], bool] | None = None,
    pv_range: tuple[float, float] = EVERYWHERE,
    ki: float = math.inf,
) -> Admission:
    """Judge a response.

    window : the response with some time before it.
    samples : what is kept, the newest last; the window was made of the last of them.
    response : what the recogniser found.
    inside : whether a sample lies in the response's region; None: there is only one.
    pv_range : what the transmitter can say, pv units. ki : of the controller, co units per pv unit and second.

    Raises ValueError: there are fewer samples than the window has.
    """
    n = len(window.t_s)
    if len(samples) < n:
        raise ValueError(f"a window of {n} samples cannot have been made of {len(samples)}")
    numbers, newest = AdmissionNumbers(), list(samples)[-n:]
    during = (window.t_s >= response.t_start_s) & (window.t_s <= response.t_end_s)
    own = [sample for sample, is_own in zip(newest, during, strict=True) if is_own]
    if not (window.t_s[0] <= response.t_start_s and own):  # nothing of it may have been forgotten before it ended
        return Admission(Ground.TOO_LONG, AdmissionNumbers(kept=float(n)))
    pv = np.array([sample.pv for sample in samples])
    of_record = _of_record(window, newest, pv, response, settings, pv_range, abs(ki))
    of_loop = _of_loop(window, own, during, response, settings, inside)
    for counted, ground in chain(of_record, of_loop):
        numbers = numbers.joined(counted)
        if ground is not None:
            return Admission(ground, numbers)
    return Admission(Ground.ADMITTED, numbers)


Counted = tuple[AdmissionNumbers, Ground | None]
"""What a rule counted, with its limit where that is not kept, and the ground against the response then."""


def _of_record(
    window: Window, samples: Sequence[LoopSample], kept: npt.NDArray[np.float64], response: Response,
    settings: AdmissionSettings, pv_range: tuple[float, float], ki: float,
) -> Iterator[Counted]:  # fmt: skip
    """Is the record that of a loop under control, by a sensor that lives? kept : pv as far as it is kept."""
    manual = float(sum(sample.mode != LoopMode.AUTO for sample in samples))
    yield AdmissionNumbers(manual=manual), Ground.MANUAL if manual else None
    # Never far outside of what the transmitter can say: that was a fault of the signal, or somebody else's frame, but
    # not where pv swings there and on: of a loop out of control the fit can tell, and nothing else ends that
    low, high = pv_range
    room = RANGE_ROOM * (high - low)
    worst = max((sample.pv for sample in samples), key=lambda pv: max(low - pv, pv - high))
    swings = len(response.peaks) > 1 and abs(response.peaks[-1].e) >= SWINGS_ON * abs(response.peaks[0].e)
    swings = swings and float(np.max(np.abs(np.diff(window.pv)))) <= JUMPS * float(np.ptp(window.pv))
    if not (low - room <= worst <= high + room or swings):
        yield AdmissionNumbers(pv_worst=worst, pv_low=low, pv_high=high), Ground.OUT_OF_RANGE
    # Telemetry complete, even in time, and new at every sample
    steps = np.diff(window.t_s) / window.sample_time_s
    whole = np.maximum(np.round(steps), 1.0)
    missing = float(np.sum(whole - 1.0))
    lost = missing / (len(steps) + missing)
    uneven = float(np.mean(np.abs(steps - whole) > settings.uneven))
    # Share of the samples that repeat the one before although integral action must have moved co
    moves = np.abs(np.diff(window.co))
    count = float(np.min(moves[moves > 0], initial=math.inf))  # a converter's, where co is coarse
    least = max(response.band, count / (ki * window.sample_time_s) if ki else math.inf)
    again = [a[1:4] == b[1:4] and not b.limited and abs(b.sp - b.pv) > least for a, b in pairwise(samples)]
    repeated = sum(again) / len(again)
    numbers = AdmissionNumbers(lost_share=lost, uneven_share=uneven, repeated_share=repeated)
    yield from (
        (replace(numbers, limit=limit), ground)
        for share, limit, ground in (
            (lost, settings.lost_share, Ground.LOST_SAMPLES),
            (uneven, settings.uneven_share, Ground.IRREGULAR),
            (repeated, settings.repeated_share, Ground.REPEATED),
        )
        if share > limit
    )
    yield numbers, None
    # The sensor did not stand still while the controller acted on it
    stood = stood_still(kept, len(window.t_s))
    if stood is not None:
        room = AT_END * (high - low)
        clipped = any(abs(stood[1] - end) <= room for end in pv_range if math.isfinite(end))
        ground = Ground.PV_CLIPPED if clipped else Ground.PV_STUCK
        yield AdmissionNumbers(stuck=float(stood[0]), stuck_at=stood[1]), ground


def _of_loop(
    window: Window, own: Sequence[LoopSample], during: npt.NDArray[np.bool_], response: Response,
    settings: AdmissionSettings, inside: Callable[[LoopSample], bool] | None,
) -> Iterator[Counted]:  # fmt: skip
    """Is it one controller in one region, its output free, and does it show anything?

    own : samples of the response itself; during : their places in the window.
    """
    # It stayed inside, where it is not taken as one that crossed a boundary (region_model/boundary_crossing.py)
    outside = sum(inside is not None and not inside(sample) for sample in own) / len(own)
    yield _at_most(settings.outside_share, AdmissionNumbers(outside_share=outside), outside, Ground.LEFT_REGION)
    # One controller all the time, as the controller itself reports it
    changes = float(sum(a.revision != b.revision for a, b in pairwise(own)))
    yield _at_most(float(settings.changes_most), AdmissionNumbers(changes=changes), changes, Ground.GAINS_CHANGED)
    # The setpoint is the loop's own: a slave's is its master's output, and moves all the time
    numbers, led = _moved(window, response, settings)
    most, most_share = float(settings.moves_most), settings.moving_share
    yield (replace(numbers, limit=most, limit_share=most_share), Ground.SETPOINT_LED) if led else (numbers, None)
    # The output is free: not at a limit for longer than the user wants to learn from
    share = sum(sample.limited != 0 for sample in own) / len(own)
    yield _at_most(settings.limited_share, AdmissionNumbers(limited_share=share), share, Ground.SATURATED)
    # co and pv move, and the response stands out of the noise, or is that of a step which is known: what a setpoint
    # step of any height shows is told by the covariance of its fit
    bands = float(np.max(np.abs(window.sp - window.pv)[during])) / response.band
    numbers, least = AdmissionNumbers(peak_bands=bands), settings.excitation_bands
    frozen_co = Ground.SATURATED if all(sample.limited for sample in own) else Ground.CO_FROZEN
    for ground, values in ((frozen_co, window.co), (Ground.PV_FROZEN, window.pv)):
        if values.max() == values.min():
            yield replace(numbers, limit=settings.limited_share), ground
    shows = bands >= least or response.sp_changed
    yield (numbers, None) if shows else (replace(numbers, limit=least), Ground.LOW_EXCITATION)


def _at_most(limit: float, numbers: AdmissionNumbers, value: float, ground: Ground) -> Counted:
    return (numbers, None) if value <= limit else (replace(numbers, limit=limit), ground)


def setpoint_led(window: Window, response: Response, settings: AdmissionSettings) -> bool:
    """Whether something else than a person moves the setpoint, in a window with its response."""
    return _moved(window, response, settings)[1]


def _moved(window: Window, response: Response, settings: AdmissionSettings) -> tuple[AdmissionNumbers, bool]:
    steps = np.abs(np.diff(window.sp))
    moving = steps > settings.still_share * response.band
    began = moving & ~np.concatenate(([False], moving[:-1]))
    moves, share = float(np.sum(began)), float(np.mean(moving))
    few = moves <= settings.moves_most and share <= settings.moving_share
    led = not few and float(np.sum(steps)) > response.band
    return AdmissionNumbers(moves=moves, moving_share=share), led
