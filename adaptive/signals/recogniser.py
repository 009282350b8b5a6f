"""The recogniser: a state machine that finds the peaks of the control error, one sample at a time.

Everything that affects its states and transitions stands in this file. The states are Foxboro EXACT's (TI 039-200,
1995): LOCATE n follows the error outward until it has retreated from an extreme by the noise band, VERIFY n waits until
the error crosses to the other side (the extreme was a peak) or rests (the response is over) or grows past the extreme
(it was none). ADAPT lasts one sample, in which the response is handed out; SETTLE waits for rest or a new upset: an
error beyond all that was left of the last response is one, for a slow tail may last until the next load.

What a sample means is worked out first, as one event; then the table says where to go:

    START     the error left twice the band                RETREAT   it came back from the extreme by one band
    NEW_MAX   it passed the extreme again                  CROSS     it stands beyond the band on the other side
    QUIET     inside the band for quiet_s                  TIMEOUT   nothing of this in time
    SETPOINT  the setpoint moved by more than the band
    GROWN     a RETREAT after a setpoint step from a second extreme several times the first: no time for a third

In time means within wait_s; after the first crossing within `reach` times what it took to get there, if that is less
(a loop with a long integral time that has crossed early shows nothing more for hours); before it, while an error comes
back by a band at a time, the wait begins anew (a sluggish loop takes many of its short integral times). A loop that
swings from the first sample on is not waited for either, once its third extreme is about as large as its first. After a
response that ended in such a swing it is a dozen of its own periods, not wait_s, until the swing is followed again.

`step` is a pure function of plain scalars; `response_of` turns the ADAPT state into a Response. A loop at rest costs
four comparisons a sample.

Other gains find the loop as the old ones left it, often far from rest. What is left then is a response of the new ones,
and shows the process as well as a step does: it begins at once, and is looked at when it has shown enough.

A setpoint step is known, however small it is: when it came, and by how much. So one that is small for the noise begins
a response as well. Its peaks drown, so it is not over when the error is inside the band, but after wait_s. Whether
its many samples together say something is for the covariance of their fit.
"""

import math
from enum import IntEnum
from typing import NamedTuple

from retuner.adaptive.signals.response import Ending, Peak, Response


class RecogniserPhase(IntEnum):
    """States, in EXACT's order."""

    LOCATE_1 = 0
    VERIFY_1 = 1
    LOCATE_2 = 2
    VERIFY_2 = 3
    LOCATE_3 = 4
    VERIFY_3 = 5
    ADAPT = 6
    SETTLE = 7


class Event(IntEnum):
    """What one sample means in the present state (see the head of this file)."""

    NONE = 0
    START = 1
    RETREAT = 2
    NEW_MAX = 3
    CROSS = 4
    QUIET = 5
    TIMEOUT = 6
    SETPOINT = 7
    GROWN = 8


_L1, _V1, _L2, _V2, _L3, _V3, _AD, _SE = RecogniserPhase

# fmt: off
TABLE: tuple[tuple[RecogniserPhase, ...], ...] = (
    # NONE START RETREAT NEW_MAX CROSS QUIET TIMEOUT SETPOINT GROWN
    (_L1, _L1, _V1, _L1, _L2, _AD, _AD, _AD, _L1),  # LOCATE_1
    (_V1, _V1, _V1, _L1, _L2, _AD, _AD, _AD, _V1),  # VERIFY_1
    (_L2, _L2, _V2, _L2, _L3, _AD, _AD, _AD, _AD),  # LOCATE_2
    (_V2, _V2, _V2, _L2, _L3, _AD, _AD, _AD, _V2),  # VERIFY_2
    (_L3, _L3, _V3, _L3, _AD, _AD, _AD, _AD, _L3),  # LOCATE_3
    (_V3, _V3, _V3, _L3, _AD, _AD, _AD, _AD, _V3),  # VERIFY_3
    (_SE, _SE, _SE, _SE, _SE, _SE, _SE, _SE, _SE),  # ADAPT
    (_SE, _L1, _SE, _SE, _SE, _L1, _L1, _L1, _SE),  # SETTLE
)
# fmt: on
"""TABLE[phase][event] is the next phase."""

STAYS_OFF = 1.25
"""Longest waits after which an error that never was at rest since the beginning is looked at once, as it is."""
SWINGS_ON = 0.7  # third extreme over the first from which a swing is not on its way to rest: its Ms is some 4 or more
PEAKS = 3  # peaks of a whole response
SWINGS_FOR = 12.0
"""Periods after which a swing that is not on its way to rest is followed again: what began it is out of sight by then.
A tone that was looked at after three of them passed for a loop that a load had set swinging."""
GROWN = 5.0  # second extreme over the first from which a setpoint's response is not waited for any longer
TAKEN_OVER = 3.0
"""A response that other gains took over in motion is looked at after so many times the length of the one before."""
START_BANDS = 2.0  # A response starts when |error| exceeds this many noise bands (about EXACT's rule; range 1.5 to 4)
LEAST_STEP = 0.5
"""Noise bands by which the setpoint must step to begin a response: with the usual band two standard deviations, which a
hundred samples tell to a tenth."""
OVER_ITS_NOISE = 2.0
"""Noise bands of the setpoint itself by which it must step: two values of it differ by more than one now and then."""
SMALL_STEP = 4.0
"""Noise bands below which a setpoint step is small: the band in which an error rests is over a quarter of it."""


class RecogniserLaw(NamedTuple):
    """Settings.

    wait_s : longest wait for the next peak, seconds (EXACT's time scale); range > 0.
    quiet_s : the error counts as at rest after this long inside the band; range 0 to wait_s.
    reach : longest wait after a crossing, in times from the upset to it; range 3 to infinite, default 5 (half a period
        of a swing is about twice the time to its first crossing).
    longest_s : longest response, seconds; what is longer is cut.
    """

    wait_s: float
    quiet_s: float
    reach: float = 5.0
    longest_s: float = math.inf


class RecogniserState(NamedTuple):
    """Where the recogniser stands, in plain scalars.

    started : an upset is being followed. since_s : when the wait for the present peak began.
    inside_s : since when the error is inside the band, infinite outside. sp, sp_changed : last setpoint taken; whether
    the upset was a setpoint change. t_start_s : first sample of the upset. t_peak_s, e_peak : the extreme followed; in
    SETTLE after a response, what was left of it. t1_s, e1, t2_s, e2 : peaks passed. verified : how many peaks are, from
    ADAPT on. event : what led to the last move.
    e_near : smallest |error| since the extreme, by which a coming back is seen, in VERIFY_1; the last error beyond the
    band in SETTLE; infinite elsewhere.
    until_s : when a response that other gains took over in motion is looked at; infinite for any other.
    awaited_s : until when rest is not asked for after a setpoint step that is small for the noise; -infinite for any
    other response.
    """

    phase: int
    started: bool
    since_s: float
    inside_s: float
    sp: float
    sp_changed: bool
    t_start_s: float
    t_peak_s: float
    e_peak: float
    t1_s: float
    e1: float
    t2_s: float
    e2: float
    verified: int
    event: int
    e_near: float = math.inf
    until_s: float = math.inf
    awaited_s: float = -math.inf


_OUTSIDE = math.inf


def begin(t_s: float, sp: float) -> RecogniserState:
    """Start in SETTLE: nothing is known of what went before."""
    return RecogniserState(
        RecogniserPhase.SETTLE, False, t_s, _OUTSIDE, sp, False, t_s, t_s, 0.0, t_s, 0.0, t_s, 0.0, 0, Event.NONE
    )


def taken_over(state: RecogniserState, t_s: float, sp: float, shortest_s: float) -> RecogniserState:
    """Other gains are in force from now on: an error that is not at rest is their response to the upset before.

    shortest_s : for so long it is followed at least.
    """
    ended_s = state.since_s if state.phase in {RecogniserPhase.ADAPT, RecogniserPhase.SETTLE} else t_s
    lasted_s = max(ended_s - state.t_start_s, 0.0)
    return begin(t_s, sp)._replace(sp_changed=state.sp_changed, until_s=t_s + max(TAKEN_OVER * lasted_s, shortest_s))


def step(
    law: RecogniserLaw, state: RecogniserState, t_s: float, sp: float, e: float, band: float, own: float = 0.0
) -> RecogniserState:
    """Take one sample: e = sp - pv, and the noise band in pv units (> 0). own : noise band of the setpoint alone."""
    if state[0] == _L1 and not state[1]:  # by their places: this runs at every sample of a loop at rest
        near = START_BANDS * band
        if -near <= e <= near:
            if sp == state[4]:
                return state
            if not _stepped(state, sp, band, own):
                return state._replace(sp=sp)
    # since when the error has been inside the band without leaving it; infinite when it is outside
    inside_s = _OUTSIDE if e > band or -e > band else state.inside_s if state.inside_s < _OUTSIDE else t_s
    event = _event(law, state, t_s, sp, e, band, own, inside_s)
    phase = TABLE[state.phase][event]
    if phase == state.phase and event == Event.NONE:
        return _follow(state, t_s, e, band, inside_s)
    if event == Event.START or (event == Event.SETPOINT and state.phase == RecogniserPhase.SETTLE):
        # An upset begins: a load, or a setpoint step, which may be small for the noise
        stepped = _stepped(state, sp, band, own)
        moved = stepped or abs(sp - state.sp) > band
        small = stepped and abs(sp - state.sp) < SMALL_STEP * band
        left = (state.until_s < math.inf or state.event == Event.GROWN) and not moved
        return state._replace(
            phase=RecogniserPhase.LOCATE_1,
            started=stepped or abs(e) > START_BANDS * band,
            since_s=t_s,
            inside_s=_OUTSIDE,
            sp=sp,
            sp_changed=moved or (left and state.sp_changed),
            until_s=state.until_s if left else math.inf,
            t_start_s=t_s,
            t_peak_s=t_s,
            e_peak=e,
            event=event,
            awaited_s=t_s + law.wait_s if small else -math.inf,
        )
    return _move(state, RecogniserPhase(phase), event, t_s, sp, e)


def _stepped(state: RecogniserState, sp: float, band: float, own: float) -> bool:
    """Whether the setpoint has moved by more than its noise, and by enough for its response to show."""
    moved, least = sp - state.sp, max(LEAST_STEP * band, OVER_ITS_NOISE * own)
    return moved > least or -moved > least


def _event(
    law: RecogniserLaw,
    state: RecogniserState,
    t_s: float,
    sp: float,
    e: float,
    band: float,
    own: float,
    inside_s: float,
) -> Event:
    """The one event that this sample is, the most telling first."""
    phase = state.phase
    moved = sp - state.sp
    if phase == RecogniserPhase.ADAPT:
        return Event.QUIET
    if (state.started or phase == RecogniserPhase.SETTLE) and (moved > band or -moved > band):
        return Event.SETPOINT
    if (phase == RecogniserPhase.SETTLE or state.awaited_s > -math.inf) and _stepped(state, sp, band, own):
        return Event.SETPOINT
    if t_s - inside_s >= law.quiet_s and t_s >= state.awaited_s:
        return Event.QUIET
    if phase == RecogniserPhase.LOCATE_1 and not state.started:
        return Event.START
    late = _late(law, state, t_s)
    if phase == RecogniserPhase.SETTLE:  # a swing is followed from where it crosses zero: its first extreme is one
        crosses = state.e_near < _OUTSIDE and e * state.e_near < 0 and (e > band or -e > band)
        over = late and (inside_s < _OUTSIDE or crosses)
        return Event.TIMEOUT if over else _settle_event(law, state, t_s, e, band)
    found = Event.TIMEOUT if late else _peak_event(phase, state.e_peak, e, band)
    return Event.GROWN if found == Event.RETREAT and _has_grown(state) else found


def _has_grown(state: RecogniserState) -> bool:
    """Whether the second extreme after a setpoint step is several times the first, under gains that made both."""
    own = state.phase == RecogniserPhase.LOCATE_2 and state.sp_changed and state.until_s == math.inf
    return own and abs(state.e_peak) > GROWN * abs(state.e1)


def _settle_event(law: RecogniserLaw, state: RecogniserState, t_s: float, e: float, band: float) -> Event:
    """Whether a new upset begins before rest; whether a motion that nobody saw begin is looked at as it is."""
    least, size = START_BANDS * band, e if e > 0 else -e
    if state.until_s < math.inf:
        return Event.START if size > least else Event.NONE
    if state.event != Event.NONE:
        anew = state.verified > 0 and size > abs(state.e_peak) + least
        return Event.START if anew else Event.NONE
    if t_s - state.since_s > STAYS_OFF * law.wait_s:
        return Event.TIMEOUT
    crosses = size > band and e * state.e_peak < 0
    first, now = abs(state.e1), abs(state.e_peak)
    return Event.TIMEOUT if crosses and first > least and now > max(SWINGS_ON * first, least) else Event.NONE


def _late(law: RecogniserLaw, state: RecogniserState, t_s: float) -> bool:
    """Whether the wait has taken too long (see the head of this file)."""
    waited = t_s - state.since_s
    if state.started and state.until_s < math.inf:  # its times are not those of a step
        return t_s > state.until_s or t_s - state.t_start_s > law.longest_s
    if waited > law.wait_s:
        return True
    if state.phase == RecogniserPhase.SETTLE:
        swings = state.verified == PEAKS and abs(state.e_peak) > SWINGS_ON * abs(state.e1)
        return swings and waited > SWINGS_FOR * (state.t_peak_s - state.t1_s)
    if t_s - state.t_start_s > law.longest_s:
        return True
    crossed = state.phase > RecogniserPhase.VERIFY_1
    return crossed and waited > max(law.reach * (state.since_s - state.t_start_s), law.quiet_s)


def _peak_event(phase: int, e_peak: float, e: float, band: float) -> Event:
    """How the error stands to the extreme that is being followed (mirrored so that the extreme is positive)."""
    if e_peak < 0:
        e, e_peak = -e, -e_peak
    if e < -band:
        return Event.CROSS
    verifying = phase in {RecogniserPhase.VERIFY_1, RecogniserPhase.VERIFY_2, RecogniserPhase.VERIFY_3}
    if verifying and e > e_peak:
        return Event.NEW_MAX
    if not verifying and e < e_peak - band:
        return Event.RETREAT
    return Event.NONE


def _follow(state: RecogniserState, t_s: float, e: float, band: float, inside_s: float) -> RecogniserState:
    """Stay; take a larger error as the new extreme, and one that has come back by a band as a new beginning."""
    if state.phase in {RecogniserPhase.LOCATE_1, RecogniserPhase.LOCATE_2, RecogniserPhase.LOCATE_3}:
        if e > state.e_peak if state.e_peak > 0 else e < state.e_peak:
            return state._replace(t_peak_s=t_s, e_peak=e, inside_s=inside_s)
    elif state.phase == RecogniserPhase.VERIFY_1:
        size = e if e > 0 else -e
        if size < state.e_near - band:
            return state._replace(since_s=t_s, inside_s=inside_s, e_near=size)
    elif state.phase == RecogniserPhase.SETTLE and state.event == Event.NONE and (e > band or -e > band):
        if e * state.e_peak < 0:
            return state._replace(e1=state.e2, e2=state.e_peak, e_peak=e, inside_s=inside_s)
        if abs(e) > abs(state.e_peak):
            return state._replace(e_peak=e, inside_s=inside_s)
    elif state.phase == RecogniserPhase.SETTLE and (e > band or -e > band) and not 0 < e * state.e_near < math.inf:
        return state._replace(e_near=e, inside_s=inside_s)
    return state if inside_s == state.inside_s else state._replace(inside_s=inside_s)


def _move(
    state: RecogniserState, phase: RecogniserPhase, event: Event, t_s: float, sp: float, e: float
) -> RecogniserState:
    """Enter a phase: what is remembered belongs to the event that leads there."""
    if phase == RecogniserPhase.ADAPT:
        # The response is over; an extreme in VERIFY n is a peak. The setpoint stays the old one: SETTLE takes the
        # new. What is left of it is nothing at rest, the tail of one that only crept back, and the last extreme
        # of a swing.
        verified = {Event.CROSS: 3, Event.GROWN: 2}.get(event, (state.phase + 1) // 2)
        ended = state._replace(
            phase=RecogniserPhase.ADAPT, since_s=t_s, inside_s=_OUTSIDE, verified=verified, event=event
        )
        if state.phase == RecogniserPhase.VERIFY_1:
            left = 0.0 if event == Event.QUIET else e
            return ended._replace(t1_s=state.t_peak_s, e1=state.e_peak, e_peak=left)
        if state.phase == RecogniserPhase.VERIFY_2 or event == Event.GROWN:
            return ended._replace(t2_s=state.t_peak_s, e2=state.e_peak)
        return ended
    if phase == RecogniserPhase.SETTLE:
        kept = Event.GROWN if state.event == Event.GROWN else event
        return state._replace(
            phase=phase, since_s=t_s, inside_s=_OUTSIDE, event=kept, until_s=math.inf, e_near=math.inf
        )
    if state.phase == RecogniserPhase.SETTLE:
        return begin(t_s, sp)._replace(phase=phase)
    if event == Event.CROSS:
        # The error is on the other side: the extreme was a peak, and the next one is followed from here
        moved = state._replace(
            phase=phase, since_s=t_s, inside_s=_OUTSIDE, t_peak_s=t_s, e_peak=e, event=Event.CROSS, e_near=math.inf
        )
        if phase == RecogniserPhase.LOCATE_2:
            return moved._replace(t1_s=state.t_peak_s, e1=state.e_peak)
        return moved._replace(t2_s=state.t_peak_s, e2=state.e_peak)
    if event == Event.NEW_MAX:
        return state._replace(phase=phase, inside_s=_OUTSIDE, t_peak_s=t_s, e_peak=e, event=event, e_near=math.inf)
    return state._replace(phase=phase, event=event, e_near=math.inf)


_ENDINGS = {
    Event.CROSS: Ending.COMPLETE,
    Event.QUIET: Ending.QUIET,
    Event.TIMEOUT: Ending.TIMEOUT,
    Event.SETPOINT: Ending.SETPOINT,
    Event.GROWN: Ending.GROWN,
}


def response_of(state: RecogniserState, band: float) -> Response | None:
    """The response that a state hands out: one in ADAPT, none in every other phase. band : noise band, pv units."""
    if state.phase != RecogniserPhase.ADAPT:
        return None
    peaks = (Peak(state.t1_s, state.e1), Peak(state.t2_s, state.e2), Peak(state.t_peak_s, state.e_peak))
    ending, taken = _ENDINGS[Event(state.event)], state.until_s < math.inf
    return Response(
        state.t_start_s, state.since_s, peaks[: state.verified], ending, state.sp_changed, band, taken_over=taken
    )


def so_far(state: RecogniserState, t_s: float, band: float) -> Response | None:
    """The response under way, cut short at t_s: its peaks and the extreme it is at; None when none is under way."""
    if not state.started or state.phase >= RecogniserPhase.ADAPT:
        return None
    passed = (Peak(state.t1_s, state.e1), Peak(state.t2_s, state.e2))[: state.phase // 2]
    peaks = (*passed, Peak(state.t_peak_s, state.e_peak))
    taken = state.until_s < math.inf
    return Response(state.t_start_s, t_s, peaks, Ending.UNDONE, state.sp_changed, band, taken_over=taken)
