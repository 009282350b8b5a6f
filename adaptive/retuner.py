"""The retuner: one sample in, now and then one decision out.

    sample -> region -> noise band -> recogniser -> window -> model -> cause -> proposal -> proof -> decision

`observe` is the per-sample path; at rest it returns after a handful of comparisons. `_decide` is the pipeline, a line a
stage. The object is a thin shell round pure steps: no clock, no file, no bus. It never writes gains: it hands out a
decision, and learns by `committed` what the controller then reported.
"""

from collections import deque
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from retuner.adaptive.decision import Action, Decision, Mode
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.tuning_cause import tuning_cause
from retuner.adaptive.estimate import LogModel
from retuner.adaptive.guard import Verdict, prove
from retuner.adaptive.noise import MEDIAN_TO_SIGMA, NoiseState, noise_start, noise_step
from retuner.adaptive.process import ProcessModel
from retuner.adaptive.recogniser import Phase, RecogniserLaw, RecogniserState, begin, step, take
from retuner.adaptive.response import Response
from retuner.adaptive.retuner_settings import RetunerSettings
from retuner.adaptive.rules.simc import simc_at_most_ms
from retuner.adaptive.rules.tuning import Tuning
from retuner.adaptive.sample import LoopMode, LoopSample, Window, finite
from retuner.adaptive.tracker import Belief, Learned, learn, predicted
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import RegionState, choose, enter
from retuner.schedule.table import GainTable


class RetunerState(NamedTuple):
    """Where a retuner stands in its record; with its table and beliefs, all that later decisions depend on."""

    region: RegionState | None
    recogniser: RecogniserState | None
    noise: NoiseState
    samples: tuple[LoopSample, ...]
    decisions: int


class Retuner:
    """Watches one loop.

    Parameters
    ----------
    table : regions and the gains in force in each.
    settings : see RetunerSettings.
    """

    def __init__(self, table: GainTable, settings: RetunerSettings) -> None:
        self.table = table
        self.settings = settings
        self.beliefs: dict[int, Belief] = {}
        self._regions = table.regions.law()
        self._samples: deque[LoopSample] = deque(maxlen=settings.history)
        self._region: RegionState | None = None
        self._state: RecogniserState | None = None
        self._noise = NoiseState(0.0, 0.0, 0.0)
        self._law = RecogniserLaw(1.0, 1.0)
        self._floor = settings.band or settings.band_min_share * settings.pv_span
        self._per_median = 0.0 if settings.band else settings.band_sigmas * MEDIAN_TO_SIGMA
        self._gap_s = settings.gap_samples * settings.sample_time_s
        self._decisions = 0

    @property
    def region(self) -> int | None:
        """Index of the region that the loop is in, None before the first sample."""
        return self._region.region if self._region else None

    @property
    def phase(self) -> Phase | None:
        """Where the recogniser stands."""
        return Phase(self._state.phase) if self._state else None

    @property
    def band(self) -> float:
        """Noise band in pv units."""
        return max(self._floor, self._per_median * self._noise.median)

    def state(self) -> RetunerState:
        """Where it stands: see memory.py, which turns it into plain values."""
        return RetunerState(self._region, self._state, self._noise, tuple(self._samples), self._decisions)

    def resume(self, state: RetunerState) -> None:
        """Go on from there."""
        self._region, self._state, self._noise, samples, self._decisions = state
        self._samples.clear()
        self._samples.extend(samples)
        self._adopt_time_scale()

    def observe(self, sample: LoopSample) -> Decision | None:
        """Take one sample; a decision comes with the sample that completes a response.

        Raises
        ------
        ValueError
            A number of the sample is not finite or its time does not increase; nothing is changed then.
        """
        state, region = self._state, self._region
        if state is None or region is None:
            self._restart(sample)
            return None
        t_s, sp, pv = sample[0], sample[1], sample[2]
        elapsed = t_s - self._samples[-1][0]
        if not 0.0 < elapsed <= self._gap_s or sample[4] != LoopMode.AUTO:
            self._restart(sample)
            return None
        x = sample[6]
        if not (pv - pv == 0.0 and sp - sp == 0.0 and sample[3] - sample[3] == 0.0 and x - x == 0.0):
            raise ValueError(f"the sample at {t_s} s is not finite: {sample}")
        now = choose(self._regions, region, x, t_s)
        if now is not region and now.region != region.region:
            return self._leave(sample, now)
        self._noise = noise = noise_step(self._noise, pv)
        band = self._per_median * noise[0]
        self._samples.append(sample)
        new = step(self._law, state, t_s, sp, sp - pv, band if band > self._floor else self._floor)
        if new is state:
            return None
        self._state = new
        return self._complete(new) if new[0] == Phase.ADAPT else None

    def committed(self, region: int, gains: PidGains) -> GainTable:
        """Take note that the controller now runs these gains in a region; returns the new table revision.

        gains : as read back from the controller (after its rounding).
        """
        self.table = self.table.with_gains(region, gains)
        self._adopt_time_scale()
        if self._state and self._samples:
            self._state = begin(self._samples[-1].t_s, self._samples[-1].sp)
        return self.table

    def _restart(self, sample: LoopSample) -> None:
        """Begin anew: the first sample, after a gap, or in manual. What is known of the regions stays."""
        if not finite(sample):
            raise ValueError(f"the sample at {sample.t_s} s is not finite: {sample}")
        if self._samples and sample.t_s <= self._samples[-1].t_s:
            raise ValueError(f"time does not increase: {sample.t_s} s after {self._samples[-1].t_s} s")
        if self._state is None:
            self._noise = noise_start(sample.pv, self._floor / self.settings.band_sigmas)
        self._noise = NoiseState(self._noise.median, sample.pv, sample.pv)
        self._region = enter(self._regions, sample.x, sample.t_s)
        self._forget(sample)

    def _leave(self, sample: LoopSample, now: RegionState) -> Decision | None:
        """The loop crossed into another region: a response under way belongs to neither."""
        state, old = self._state, self._region
        assert state is not None
        assert old is not None
        under_way = state.started and state.phase < Phase.ADAPT
        discarded = (
            self._decision(old.region, "the response left its region; it teaches nothing of either")
            if under_way
            else None
        )
        self._region = now
        self._noise = noise_step(self._noise, sample.pv)
        self._forget(sample)
        return discarded

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
        gains = self.table.gains_of(self._region.region)
        tau_i = gains.kp / gains.ki if gains.ki else 0.0
        wait = s.wait_s or max(s.wait_tau_i * tau_i, s.shortest_wait * s.sample_time_s)
        self._law = RecogniserLaw(wait, min(max(s.quiet_tau_i * tau_i, s.shortest_quiet * s.sample_time_s), wait))

    def _complete(self, state: RecogniserState) -> Decision | None:
        """A response is complete: decide on it."""
        response = take(state, self.band)
        assert response is not None
        assert self._region is not None
        if self.settings.mode == Mode.OFF:
            return None
        return self._decide(self._region.region, response)

    def _decide(self, region: int, response: Response) -> Decision:
        """The pipeline, a line a stage; each stage may end it with its reason."""
        window = self._window(response)
        in_force = self.table.gains_of(region)
        refusal = self._inadmissible(window, response)
        if refusal is not None:
            return self._decision(region, refusal.reason, response=response, diagnosis=refusal)
        try:
            learned = self._learn(region, window, in_force.direction)
        except np.linalg.LinAlgError as error:  # a record that breaks the arithmetic must not break the supervision
            return self._decision(region, f"the fit failed: {error}", response=response)
        if learned.belief is None:
            return self._decision(region, learned.estimate.reason, response=response, learned=learned)
        log = predicted(learned.belief, float(window.t_s[-1]), self.settings.tracker)
        tuning, diagnosis = self._diagnose(log, in_force)
        if not diagnosis.retune:
            return self._decision(region, diagnosis.reason, response=response, learned=learned, diagnosis=diagnosis)
        half_sample = self.settings.sample_time_s / 2
        verdict = prove(tuning, log, half_sample, in_force, self.settings.guard)
        return self._decision(
            region,
            diagnosis.reason if verdict.accepted else str(verdict.ruling),
            response=response,
            learned=learned,
            diagnosis=diagnosis,
            proposal=tuning,
            verdict=verdict,
        )

    def _learn(self, region: int, window: Window, sign: int) -> Learned:
        """Take the record into what is known of the region."""
        learned = learn(self.beliefs.get(region), window, sign, self.settings.tracker, self.settings.fit)
        if learned.belief is not None:
            self.beliefs[region] = learned.belief
        return learned

    def _window(self, response: Response) -> Window:
        """The response with some of the time before it."""
        s = self.settings
        lead = s.lead_share * (response.t_end_s - response.t_start_s) + s.lead_samples * s.sample_time_s
        first = response.t_start_s - lead
        skip = next((i for i, sample in enumerate(self._samples) if sample.t_s >= first), 0)
        return Window.of(list(islice(self._samples, skip, None)))

    def _inadmissible(self, window: Window, response: Response) -> Diagnosis | None:
        """Why a record may not teach anything, if so."""
        recent = islice(reversed(self._samples), len(window.t_s))
        share = sum(1 for sample in recent if sample.limited) / len(window.t_s)
        evidence = {"limited_share": share, "peaks": float(len(response.peaks))}
        if response.t_start_s < self._samples[0].t_s:
            reason = f"the response is longer than the {self.settings.history} samples kept: its beginning is missing"
            return Diagnosis(Cause.UNKNOWN, 1.0, evidence, reason)
        if share > self.settings.cause.saturated_share:
            reason = f"the controller output stood at a limit for {share:.0%} of the response"
            return Diagnosis(Cause.SATURATION, 1.0, evidence, reason)
        for name, values in (("co", window.co), ("pv", window.pv)):
            if values.max() == values.min():
                return Diagnosis(Cause.UNKNOWN, 1.0, evidence, f"{name} does not move: nothing to learn from")
        return None

    def _diagnose(self, log: LogModel, in_force: PidGains) -> tuple[Tuning, Diagnosis]:
        """What the rule would give, and whether the tuning is the cause."""
        model = self._tuning_model(log)
        guard = self.settings.guard
        target = min(guard.ms_target, guard.ms_nominal)
        tuning, _ = simc_at_most_ms(model, target, guard.tau_c_max_ratio)
        unsure = log.gain_uncertainty(self.settings.sample_time_s / 2)
        diagnosis = tuning_cause(model, in_force, tuning.gains, unsure, self.settings.cause)
        return tuning, diagnosis

    def _tuning_model(self, log: LogModel) -> ProcessModel:
        """The model with half a sampling interval of dead time added: what a sampled controller sees."""
        m = log.model()
        return replace(m, theta_s=m.theta_s + self.settings.sample_time_s / 2)

    def _decision(
        self,
        region: int,
        reason: str,
        *,
        response: Response | None = None,
        learned: Learned | None = None,
        diagnosis: Diagnosis | None = None,
        proposal: Tuning | None = None,
        verdict: Verdict | None = None,
    ) -> Decision:
        """Put the record together."""
        accepted = verdict is not None and verdict.accepted
        wanted = Action.COMMIT if self.settings.mode == Mode.AUTO else Action.ADVISE
        belief = learned.belief if learned else None
        self._decisions += 1
        return Decision(
            number=self._decisions,
            t_s=self._samples[-1].t_s,
            loop=self.table.loop,
            region=self.table.regions.names[region],
            action=wanted if accepted else Action.NONE,
            reason=reason,
            gains_before=self.table.gains_of(region),
            gains_after=verdict.gains if verdict else None,
            response=response,
            estimate=learned.estimate if learned else None,
            surprise=learned.surprise if learned else None,
            records=belief.records if belief else 0,
            diagnosis=diagnosis,
            proposal=proposal,
            verdict=verdict,
        )
