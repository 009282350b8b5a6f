"""Before a change: is the response a clear case, or must the whole diagnosis confirm that it is the tuning?

    clear        a setpoint step excited a loop that was at rest, and the loop by itself explains the response with at
                 most one load step; or the loop runs away at such a step, or the change makes a loop safer that
                 swings at its own crossover between the output's limits (swing_checks.py)
    known        a clear setpoint step is among what the model rests on, and this response agrees with it
    not clear    the others: a load of unknown shape taken for a step can fit any process. The whole diagnosis of the
                 stretch with its rivals and doubts must name the tuning; where no setpoint step was seen, after two
                 load responses at the earliest.

What an outside sinusoid or a valve does to a loop looks like a load response for the first cycles (measured: without
this stage 6 of 10 loops with good gains were changed).
"""

import math
from collections.abc import Sequence

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis, asks_for_less
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.oscillation_online import SwingSettings, stretch
from retuner.adaptive.guard.ruling import Ruling
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

TOWARDS_SAFETY = frozenset({Ruling.SAFER, Ruling.URGENT})  # rulings of the guard that make a loop over its limit safer
SWINGING = frozenset({Cause.AGGRESSIVE, Cause.SLOW_INTEGRATING})
"""Causes of tuning by which a loop swings; by the other it is slow."""


@dataclass(frozen=True, slots=True)
class Excitation:
    """How many responses of each kind the model of a region rests on.

    clear : of the setpoint responses, how many were clear (see is_clear). alternative : the same of what last
    contradicted it. rested : how many of the last load responses in a row led from rest to rest
    (see from_rest_to_rest). lost : how many of the last responses in a row, of any kind, left the loop unstable on
    every plausible model, whichever models these were.
    """

    setpoints: int = 0
    loads: int = 0
    clear: int = 0
    alternative: int = 0
    rested: int = 0
    lost: int = 0

    def __post_init__(self) -> None:
        for name in ("setpoints", "loads", "clear", "alternative", "rested", "lost"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} = {getattr(self, name)} must be 0 or more")

    def with_response(self, response: Response, *, clear: bool = False, rested: bool = False) -> "Excitation":
        """One more."""
        setpoint = bool(response.sp_changed)
        return replace(
            self,
            setpoints=self.setpoints + setpoint,
            loads=self.loads + (not setpoint),
            clear=self.clear + clear,
            rested=self.rested if setpoint else self.rested + 1 if rested else 0,
        )

    def of_alternative(self) -> "Excitation":
        """The excitation of the model that contradicted this one, when it takes over."""
        return Excitation(setpoints=self.alternative, clear=self.alternative)


def is_clear(
    samples: Sequence[LoopSample], response: Response, left: float, loads: int, settings: SwingSettings
) -> bool:
    """Whether a response needs no confirmation.

    samples : kept, the newest last. left : what the linear fit leaves, in noise standard deviations. loads : load steps
    that it needed. One that other gains took over in motion goes on with what was judged when they came.
    """
    explained = left <= settings.unexplained and loads <= settings.loads_beside
    from_rest = response.taken_over or was_at_rest(samples, response, settings)
    return bool(response.sp_changed) and explained and from_rest


def runs_away(samples: Sequence[LoopSample], response: Response, explained: float, settings: SwingSettings) -> bool:
    """Whether a setpoint step was answered by a swing that grows, and the loop by itself explains it: no rest needed.

    An unstable loop is never at rest, there is no time to wait for it, and its own swing looks like loads to a fit.
    explained : share of pv's variance that the model explains.
    """
    growth = response.overshoot if response.damping is None else response.damping  # of two peaks, or of three
    grows = bool(response.sp_changed) and growth is not None and growth > settings.grows
    return grows and explained >= settings.growth_explained and calm_before(samples, response, settings)


def calm_before(samples: Sequence[LoopSample], response: Response, settings: SwingSettings) -> bool:
    """Whether the error moved little before a response, against the swing in it (its last peak)."""
    swing = abs(response.peaks[-1].e) if response.peaks else 0.0
    since = 2 * response.t_start_s - response.t_end_s
    before = max((abs(s.sp - s.pv) for s in samples if since <= s.t_s < response.t_start_s), default=0.0)
    return before <= max(settings.calm * swing, response.band)


def was_at_rest(samples: Sequence[LoopSample], response: Response, settings: SwingSettings, share: float = 1.0) -> bool:
    """Whether the error kept to its noise band before a response, for a share of what the response took, or as far as
    is known.
    """
    since = response.t_start_s - share * (response.t_end_s - response.t_start_s)
    before = [s for s in samples if since <= s.t_s < response.t_start_s]
    outside = sum(1 for s in before if abs(s.sp - s.pv) > response.band)
    return outside <= settings.restless * len(before)


def from_rest_to_rest(samples: Sequence[LoopSample], response: Response, settings: SwingSettings) -> bool:
    """Whether a loop was at rest before a response and came to rest after it.

    A slow tone rests as well where it crosses, but for less than a third of what its half waves take.
    """
    if response.ending is not Ending.QUIET or response.taken_over:
        return False
    least_s = settings.rest_between * (response.t_end_s - response.t_start_s)
    is_kept = samples[0].t_s <= response.t_start_s - least_s
    return is_kept and was_at_rest(samples, response, settings, settings.rest_between)


def unconfirmed(
    samples: Sequence[LoopSample],
    response: Response,
    gains: PidGains,
    excitation: Excitation,
    swing: SwingSettings,
    settings: DiagnosisSettings,
    wanted: Diagnosis | None = None,
) -> Diagnosis | None:
    """Why a case that is not clear may not change gains, None when the whole diagnosis names the tuning.

    samples : kept, the newest last. gains : in force. excitation : this response included. wanted : why they would
    be changed, None where no model said so.
    """
    if not excitation.setpoints and excitation.loads < swing.fewest_loads:
        reason = "one load response is not enough: another one, or a setpoint step, must agree"
        evidence = {"setpoint_responses": float(excitation.setpoints), "load_responses": float(excitation.loads)}
        return Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason)
    length_s = response.t_end_s - response.t_start_s
    stretched = stretch(samples, response.t_start_s - swing.most_lookback * length_s, swing.same_gains)
    seen = from_rest(stretched, response, swing)
    found, of = _diagnosed(seen, response, gains, swing, settings), settings.cause
    if found.cause in TUNING_CAUSES and wanted is not None and asks_for_less(found, of) != asks_for_less(wanted, of):
        reason = f"{found.cause}, where the model of this region gives {wanted.cause}: {found.reason}"
        found = replace(found, cause=Cause.UNKNOWN, confidence=0.5, reason=reason)
    if found.cause in TUNING_CAUSES:  # the settings are those of the region's model
        return None
    return replace(found, reason=f"the record since {seen[0].t_s:,.0f} s does not confirm it: {found.reason}")


def _diagnosed(
    seen: list[LoopSample], response: Response, gains: PidGains, swing: SwingSettings, settings: DiagnosisSettings
) -> Diagnosis:
    """The diagnosis of a stretch; where it holds more than can be explained at once, that of its last two responses."""
    found = diagnose_window(Window.of(seen), gains, settings=settings).diagnosis
    if found.cause is not Cause.UNKNOWN or found.evidence.get("linear_left", 0.0) <= settings.explained:
        return found
    two = last_two(seen, response, swing)
    if len(two) == len(seen):
        return found
    again = diagnose_window(Window.of(two), gains, settings=settings).diagnosis
    return again if again.cause in TUNING_CAUSES else found


def last_two(samples: list[LoopSample], response: Response, settings: SwingSettings) -> list[LoopSample]:
    """The samples from the rest before the response before this one; all, where the loop was not at rest in between."""
    needed_s = settings.rest * (response.t_end_s - response.t_start_s)
    rests, after_s = 0, response.t_start_s
    moved = False
    for i in range(len(samples) - 1, -1, -1):
        sample = samples[i]
        if sample.t_s >= response.t_start_s:
            continue
        if abs(sample.sp - sample.pv) > response.band:
            after_s, moved = sample.t_s, True
        elif after_s - sample.t_s >= needed_s and (moved or not rests):
            rests, moved = rests + 1, False
            if rests > 1:
                return samples[i:]
    return samples


def from_rest(samples: list[LoopSample], response: Response, settings: SwingSettings) -> list[LoopSample]:
    """Without the motion with which a stretch begins: its cause lies before it, so nothing in it explains the motion.

    samples : a stretch that holds the response. When the loop never was at rest before the response, all since the
    last motion that dwarfs it.
    """
    needed_s = settings.rest * (response.t_end_s - response.t_start_s)
    most = settings.dwarfs * max((abs(peak.e) for peak in response.peaks), default=math.inf)
    since = dwarfed = 0
    for i, sample in enumerate(samples):
        if sample.t_s >= response.t_start_s:
            break
        if abs(sample.sp - sample.pv) > most:
            dwarfed = i + 1
        if abs(sample.sp - sample.pv) > response.band:
            since = i + 1
        elif sample.t_s - samples[since].t_s >= needed_s:
            return samples[since:]
    return samples[dwarfed:]
