"""The watch over a trial, sample by sample: a set that makes the loop run away is rolled back in mid-response.

Half waves of the error beyond twice the noise band are followed, and beyond what a load that never rests did of itself
before the change; r is the ratio of one's extreme to the last one's.

    r >= grows twice in a row          RUNAWAY   three half waves, each larger than the last (the third one need not
                                                 have reached its extreme)
    r >= stays, stays_for in a row     RUNAWAY   a swing that does not die out
    limit to limit, limit_swings times RUNAWAY   the output goes back and forth between its limits
    pv at an end of its range, twice   RUNAWAY   in two half waves, further off than ever under the set before
    at one limit for limited_s         SATURATED the trial shows nothing of the gains

A half wave that was under way when the trial began may have had its extreme before: nothing is measured against it. A
half wave in which the output stood at a limit is that of an open loop under a known input: it is passed over, and the
next one is measured against the last free one. All counts begin anew with a setpoint change that could make such a
swing, not with one that is small against it (a setpoint that another loop moves at every sample would blind the watch),
and after a rest: when the error kept to its band for longer than the half wave before took, what comes is another
upset. `grows` and `stays` are never below what was promised, nor below what the gains before did on the best model:
then undoing would be no cure. Six comparisons a sample.
"""

import math
from typing import NamedTuple

from retuner.adaptive.signals.sample import EVERYWHERE, LoopSample
from retuner.adaptive.trial.phase import TrialEvent
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.trial_settings import TrialSettings

SEEN_BANDS = 2.0  # A half wave counts from this many noise bands
MOVED = 0.25  # A setpoint change below this share of the swing under way does not make a half wave of it
MOST_GROWTH = 2.0  # growth per half wave from which a loop runs away whatever was before
TWICE = 2  # growing half waves after the first, or such at an end of pv's range, that make the trial a diverging one


class DivergenceLimits(NamedTuple):
    """Thresholds (see the head of this file); limited_s in seconds, others in pv units. least : of a half wave that
    counts. furthest : error under the set before. low, high : ends of pv's range.
    """

    grows: float
    stays: float
    stays_for: int
    limit_swings: int
    limited_s: float
    least: float = 0.0
    furthest: float = math.inf
    low: float = -math.inf
    high: float = math.inf


class DivergenceState(NamedTuple):
    """Where the watch stands: setpoint; extreme of the half wave under way and of the one before (signed, 0: none);
    how many have grown and stayed in a row; last limit touched (-1, 0, 1), swings between limits, and since when the
    output stands at one (infinite when it does not); since when the half wave under way lasts, and since when the error
    is back in its band (infinite when it is not). joined : the half wave under way began before the watch. held : the
    output stood at a limit in it. ends : half waves in which pv went to an end of its range; at_end : this one.
    """

    sp: float
    extreme: float
    last: float
    grown: int
    stayed: int
    limit: int
    swings: int
    since_s: float
    wave_s: float = math.inf
    inside_s: float = math.inf
    joined: bool = False
    held: bool = False
    ends: int = 0
    at_end: bool = False


def law_of(
    prediction: Prediction, settings: TrialSettings, shortest_s: float, pv_range: tuple[float, float] = EVERYWHERE
) -> DivergenceLimits:
    """The thresholds for one trial. shortest_s : least time at a limit that counts, s. pv_range : its ends."""
    high = max(prediction.setpoint.decay.high, prediction.load_step.decay.high) + settings.decay_slack
    before = min(max(prediction.decay_before(setpoint=True), prediction.decay_before(setpoint=False)), MOST_GROWTH)
    least = max(min(high, MOST_GROWTH), before if before > 1 else 0.0)
    patience = prediction.patience_s if math.isfinite(prediction.patience_s) else 0.0
    return DivergenceLimits(
        max(settings.grows, least),
        max(settings.stays, least),
        settings.stays_for,
        settings.limit_swings,
        max(settings.limited_settles * patience, shortest_s),
        max(settings.seen_wanders / 2 * prediction.wander, prediction.moved),
        prediction.furthest,
        *pv_range,
    )


def divergence_begin(sp: float, *, joined: bool = True) -> DivergenceState:
    """The watch before anything is seen. joined : a half wave may be under way, as when a trial begins."""
    return DivergenceState(sp, 0.0, 0.0, 0, 0, 0, 0, math.inf, joined=joined)


def divergence_step(
    law: DivergenceLimits, state: DivergenceState, sample: LoopSample, band: float
) -> tuple[DivergenceState, TrialEvent | None]:
    """Take one sample; the event that ends the trial, if this is it. band : noise band, pv units."""
    if abs(sample.sp - state.sp) > max(band, MOVED * abs(state.extreme), MOVED * abs(state.last)):
        state = divergence_begin(sample.sp, joined=False)
    # which limit the output touches, and since when
    if not sample.limited:
        state = state if math.isinf(state.since_s) else state._replace(since_s=math.inf)
    elif sample.limited == state.limit:
        state = state._replace(since_s=min(state.since_s, sample.t_s))
    else:
        state = state._replace(limit=sample.limited, swings=state.swings + (state.limit != 0), since_s=sample.t_s)
    if state.swings >= law.limit_swings:
        return state, TrialEvent.RUNAWAY
    if sample.t_s - state.since_s >= law.limited_s:
        return state, TrialEvent.SATURATED
    e = sample.sp - sample.pv
    if abs(e) <= max(SEEN_BANDS * band, law.least):
        return state if math.isfinite(state.inside_s) else state._replace(inside_s=sample.t_s), None
    # After a rest, half waves are counted anew
    rest_s, wave_s = sample.t_s - state.inside_s, state.inside_s - state.wave_s
    if rest_s > wave_s:
        state = state._replace(extreme=0.0, last=0.0, grown=0, stayed=0, joined=False, held=False, ends=0, at_end=False)
    if e * state.extreme < 0:
        state = state._replace(at_end=False)
    if not state.at_end and abs(e) > law.furthest and not law.low < sample.pv < law.high:
        state = state._replace(ends=state.ends + 1, at_end=True)
    state = _follow(law, state._replace(inside_s=math.inf), e, sample.t_s)
    state = state._replace(held=True) if sample.limited and not state.held else state
    grows = state.last != 0 and not state.held and abs(state.extreme) >= law.grows * abs(state.last)
    growing = state.grown + grows
    runs = growing >= TWICE or state.stayed >= law.stays_for or state.ends >= TWICE
    return state, TrialEvent.RUNAWAY if runs else None


def _follow(law: DivergenceLimits, state: DivergenceState, e: float, t_s: float) -> DivergenceState:
    """The half wave under way goes on, or a new one begins on the other side."""
    if state.extreme == 0:
        return state._replace(extreme=e, wave_s=t_s)
    if e * state.extreme > 0:
        return state._replace(extreme=e) if abs(e) > abs(state.extreme) else state
    if state.joined:
        return state._replace(extreme=e, wave_s=t_s, joined=False, held=False)
    if state.held:
        return state._replace(extreme=e, wave_s=t_s, held=False)
    ratio = abs(state.extreme / state.last) if state.last else 0.0
    grown = state.grown + 1 if ratio >= law.grows else 0
    stayed = state.stayed + 1 if ratio >= law.stays else 0
    return state._replace(extreme=e, last=state.extreme, grown=grown, stayed=stayed, wave_s=t_s)
