"""The finder: one sample in, now and then a completed response out.

    sample -> region -> noise band -> recogniser -> response with its samples

`step` is the per-sample path; at rest it returns after a handful of comparisons. What a response means is not its
business: see decide.py. While a scheduling variable is not known (a signal on the bus is stale), the region stays and
no response is taken: nobody could say where it belongs.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from retuner.adaptive.signals.noise import (
    MEDIAN_TO_SIGMA,
    NoiseState,
    noise_at_least,
    noise_start,
    noise_step,
    quantum_sigma,
    wander_before,
)
from retuner.adaptive.signals.recogniser import (
    RecogniserLaw,
    RecogniserPhase,
    RecogniserState,
    begin,
    response_of,
    so_far,
    step,
    taken_over,
)
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopMode, LoopSample, Window, finite, plain
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import CAN, Regions, RegionState, choose, enter, values

AUTO = LoopMode.AUTO
CLEAN_SHARE = 0.5
"""Share of the smallest band that a setpoint without noise counts for: a few steps do not lift it to the band."""


class FinderState(NamedTuple):
    """Where a finder stands in its record; with the gains in force, all that its later responses depend on.

    noise : of pv. setpoint : noise of the setpoint; None for one of which nothing is known. rounding : standard
    deviation that pv's rounding to the steps of its sensor has, pv units; 0 where it is not seen. broken : gaps in a
    row that came before a response was complete.
    """

    region: RegionState | None
    recogniser: RecogniserState | None
    noise: NoiseState
    samples: tuple[LoopSample, ...]
    setpoint: NoiseState | None = None
    rounding: float = 0.0
    broken: int = 0


class Completed(NamedTuple):
    """A response. region : in which it ended. entered_s : since when the loop was there.

    wander : standard deviation of noise that wanders, or of rounding in a sensor of coarse steps, pv units; the
    response's band has been widened for it.
    """

    region: int
    response: Response
    entered_s: float = -math.inf
    wander: float = 0.0


class Left(NamedTuple):
    """It is not known any more where the loop is, or samples are missing again and again.

    region : where it was. under_way : a response was cut off by it. broken : gaps in a row that came before a response
    was complete, where that is to be told; else 0.
    """

    region: int
    under_way: bool
    broken: int = 0


FIRST_TOLD, THEN = 3, 10
"""Gaps in a row after which it is said that nothing can be evaluated, and the factor to the next time."""


GainsAt = Callable[[int, float, float], PidGains]
"""The gains in force in a region, by index, at the scheduling values x and x2."""


class ResponseFinder:
    """Finds the responses in the samples of one loop.

    regions : the operating regions. gains_at : the gains in force (their integral time sets the waiting times).
    settings : see RetunerSettings.
    """

    def __init__(self, regions: Regions, gains_at: GainsAt, settings: RetunerSettings) -> None:
        self._axes, self._gains_at = regions.axes, gains_at
        self.settings = settings
        self._regions = regions.law()
        self._samples: deque[LoopSample] = deque(maxlen=settings.history)
        self._region: RegionState | None = None
        self._state: RecogniserState | None = None
        self._median, self._last, self._before = NoiseState(0.0, 0.0, 0.0)
        self._law = RecogniserLaw(1.0, 1.0)
        self._floor = self._least = settings.band or settings.band_min_share * settings.pv_span
        self._per_median = 0.0 if settings.band else settings.band_sigmas * MEDIAN_TO_SIGMA
        self._per_setpoint = settings.band_sigmas * MEDIAN_TO_SIGMA
        self._gap_s = settings.gap_samples * settings.sample_time_s
        self._clean = noise_start(CLEAN_SHARE * self._floor / settings.band_sigmas)
        self._setpoint = NoiseState(self._clean, 0.0, 0.0)
        self._rounding = 0.0
        self._broken = 0

    @property
    def region(self) -> int | None:
        """Index of the region that the loop is in, None before the first sample."""
        return self._region.region if self._region else None

    @property
    def entered_s(self) -> float:
        """Since when the loop is in its region; minus infinity before the first sample."""
        return max(self._region.since_s, self._region.since2_s) if self._region else -math.inf

    @property
    def scheduled(self) -> tuple[float, float]:
        """The scheduling values in force, filtered and the last good ones; 0 before the first sample."""
        if self._region is None or not self._samples:
            return 0.0, 0.0
        newest = self._samples[-1]
        return values(self._regions, self._region, newest.x, newest.x2)

    @property
    def at_rest(self) -> bool:
        """Whether it waits for the next response, and none has begun."""
        state = self._state
        return state is not None and state.phase == RecogniserPhase.LOCATE_1 and not state.started

    @property
    def band(self) -> float:
        """Noise band of the error in pv units: of pv, and of a setpoint that has noise of its own."""
        return self._of_error(max(self._floor, self._per_median * self._median))

    @property
    def samples(self) -> Sequence[LoopSample]:
        """The samples that are kept, the newest last."""
        return self._samples

    @property
    def recogniser(self) -> RecogniserState | None:
        """The recogniser's state, None before the first sample."""
        return self._state

    def cut_short(self, state: RecogniserState | None) -> Completed | None:
        """The response that was under way in a state of the recogniser, up to now; None when there was none."""
        if state is None or self._region is None or not self._samples:
            return None
        response = so_far(state, self._samples[-1].t_s, self.band)
        return self._completed(self._region, response) if response else None

    def state(self) -> FinderState:
        """Where it stands: see state_file.py, which turns it into plain values."""
        noise = NoiseState(self._median, self._last, self._before)
        return FinderState(
            self._region, self._state, noise, tuple(self._samples), self._setpoint, self._rounding, self._broken
        )

    def resume(self, state: FinderState) -> None:
        """Go on from there."""
        self._region, self._state, noise, samples, setpoint, rounding, self._broken = state
        self._take_rounding(rounding)
        self._setpoint = setpoint or NoiseState(self._clean, 0.0, 0.0)
        self._median, self._last, self._before = noise
        self._samples.clear()
        self._samples.extend(samples)
        self._adopt_time_scale()

    def step(self, sample: LoopSample) -> Completed | Left | None:
        """Take one sample; what is told comes with the sample that completes it.

        Raises ValueError: a number of the sample is not finite or its time does not increase; nothing is changed then.
        """
        t_s, sp, pv, co, mode, _, x, revision, x2 = sample
        is_plain = type(t_s) is type(sp) is type(pv) is type(co) is type(x) is type(x2) is float
        if not is_plain or type(revision) is not int:
            return self.step(plain(sample))
        state, region, samples = self._state, self._region, self._samples
        if state is None or region is None:
            if self._is_placed(sample):
                self._restart(sample)
            return None
        last = samples[-1]
        if mode != AUTO or last[4] != AUTO or not 0.0 < t_s - last[0] <= self._gap_s:  # manual is no part of a record
            cut = sample.mode == AUTO and sample.t_s - self._samples[-1].t_s > self._gap_s and not self.at_rest
            self._restart(sample)
            if not cut:
                return None
            self._broken += 1  # told after some in a row, and ever more seldom
            told = FIRST_TOLD
            while told < self._broken:
                told *= THEN
            return Left(region.region, under_way=False, broken=told) if told == self._broken else None
        total = sp + pv + co + x + x2
        if total - total != 0.0 and not self._is_placed(sample):
            # The region stays, and nothing is learned
            self._region = choose(self._regions, region, sample.x, sample.t_s, sample.x2)
            self._hear(sample.pv)
            self._setpoint = noise_at_least(self._setpoint, sample.sp, self._clean)
            self._forget(sample)
            return Left(region.region, state.started and state.phase < RecogniserPhase.ADAPT)
        now = choose(self._regions, region, x, t_s, x2)
        if now is not region:
            self._region = now
            if now[0] != region[0]:
                self._adopt_time_scale()
        heard = self._setpoint
        if not sp == heard.last == heard.before or heard.median > self._clean:
            self._setpoint = noise_at_least(heard, sp, self._clean)
        samples.append(sample)
        band = self._of_error(max(self._floor, self._per_median * self._hear(pv)))
        new = step(self._law, state, t_s, sp, sp - pv, band, self._per_setpoint * self._setpoint.median)
        if new is state:
            return None
        self._state = new
        return self._complete(new) if new[0] == RecogniserPhase.ADAPT else None

    def gains_changed(self) -> None:
        """Other gains are in force: what is under way is their response from now on."""
        self._adopt_time_scale()
        if self._state and self._samples:
            shortest_s = self.settings.shortest_wait * self.settings.sample_time_s
            self._state = taken_over(self._state, self._samples[-1].t_s, self._samples[-1].sp, shortest_s)

    def window(self, response: Response, wander: float = 0.0) -> Window:
        """The response with some of the time before it. wander : see Completed."""
        s = self.settings
        lead = s.lead_share * (response.t_end_s - response.t_start_s) + s.lead_samples * s.sample_time_s
        first = response.t_start_s - lead
        skip = next((i for i, sample in enumerate(self._samples) if sample.t_s >= first), 0)
        return replace(Window.of(list(islice(self._samples, skip, None))), noise_std=wander)

    def _restart(self, sample: LoopSample) -> None:
        """Begin anew: the first sample, after a gap, or in manual. What is known of the regions stays."""
        self._is_placed(sample)
        if self._samples and sample.t_s <= self._samples[-1].t_s:
            raise ValueError(f"time does not increase: {sample.t_s} s after {self._samples[-1].t_s} s")
        if self._state is None:
            self._median = noise_start(self._floor / self.settings.band_sigmas)
        self._last = self._before = sample.pv
        self._setpoint = NoiseState(self._setpoint.median, sample.sp, sample.sp)
        region = self._region
        if region is not None and sample.t_s - self._samples[-1].t_s <= self._gap_s:
            self._region = choose(self._regions, region, sample.x, sample.t_s, sample.x2)
        else:
            self._region = enter(self._regions, sample.x, sample.t_s, sample.x2, region)
        self._forget(sample)

    def _is_placed(self, sample: LoopSample) -> bool:
        """Whether it is known where the sample lies; only a signal on the bus may be unknown.

        Raises ValueError: another number of the sample is not finite.
        """
        if not finite(sample):
            raise ValueError(f"the sample at {sample.t_s} s is not finite: {sample}")
        for axis, value in zip(self._axes, (sample.x, sample.x2), strict=False):
            if not math.isfinite(value):
                if axis.variable != CAN:
                    raise ValueError(f"the sample at {sample.t_s} s is not finite: {sample}")
                return False
        return True

    def _hear(self, pv: float) -> float:
        """Follow the noise: the next median."""
        last = self._last
        self._median = median = noise_step(self._median, pv - 2.0 * last + self._before)
        self._last, self._before = pv, last
        return median

    def _seen_rounding(self) -> float:
        """Standard deviation of pv's rounding in the samples that are kept."""
        return quantum_sigma(np.array([sample.pv for sample in self._samples]))

    def _take_rounding(self, sigma: float) -> None:
        """A sensor of coarse steps: what stands within one of them is at rest."""
        self._rounding = sigma
        if not self.settings.band:
            self._floor = max(self._least, self.settings.band_sigmas * sigma)

    def _of_error(self, band: float) -> float:
        """Noise band of sp - pv, from that of pv: independent noises add by their squares."""
        own = self._per_median * self._setpoint.median
        return math.hypot(band, own) if own > self._floor else band

    def _forget(self, sample: LoopSample) -> None:
        """Drop the samples and let the recogniser settle."""
        self._samples.clear()
        self._samples.append(sample)
        self._state = begin(sample.t_s, sample.sp)
        self._adopt_time_scale()

    def _adopt_time_scale(self) -> None:
        """Waiting times that suit the integral time in force."""
        if self._region is None:
            return
        s = self.settings
        gains = self._gains_at(self._region.region, *self.scheduled)
        tau_i = gains.kp / gains.ki if gains.ki else 0.0
        wait = s.wait_s or max(s.wait_tau_i * tau_i, s.shortest_wait * s.sample_time_s)
        quiet = min(max(s.quiet_tau_i * tau_i, s.shortest_quiet * s.sample_time_s), wait)
        longest = (s.history - s.lead_samples) / (1 + s.lead_share) * s.sample_time_s  # its window is then still kept
        self._law = RecogniserLaw(wait, quiet, longest_s=longest)

    def _complete(self, state: RecogniserState) -> Completed:
        response = response_of(state, self.band)
        self._broken = 0
        assert response is not None
        assert self._region is not None
        self._take_rounding(self._seen_rounding())
        return self._completed(self._region, response)

    def _completed(self, region: RegionState, response: Response) -> Completed:
        """The response with its noise's band, which may wander or be rounded; one that a person has set stays."""
        wander = max(wander_before(self._samples, response), self._seen_rounding())
        if wander and not self.settings.band:
            response = replace(response, band=max(response.band, self.settings.band_sigmas * wander))
        return Completed(region.region, response, max(region.since_s, region.since2_s), wander)
