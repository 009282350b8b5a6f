"""Setpoint steps to and fro: where they are in the samples.

    base -> base + a -> base - a -> base + a -> ... -> base        a half step, whole steps, a half step

Steps of one size to both sides are no operator's work: they are made to be read together (setpoint_steps.py), at even
times or not.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from retuner.adaptive.signals.sample import LoopSample

WHOLE_STEPS = 4  # whole steps that say something together: two up, two down
SAME = 0.02  # share of a step by which another may differ from it: what a controller rounds
OVERDUE = 1.5  # times the longest time between two steps after which the next will not come
STANDS = 5  # samples for which a setpoint stands at least between steps: one that moves faster is noise, or led
MOST_MOVES = 40  # most moves that may belong to one sequence
LED_MOVES = 2
LED_REACH = 2.5
"""So many moves within so many times the time between two steps, before the first: the setpoint is led, and does not
step."""


class SetpointMove(NamedTuple):
    """A move of the setpoint: the first sample at the new one, and by how much it moved, pv units."""

    at: int
    size: float


class StepSequence(NamedTuple):
    """Where the steps are in a list of samples.

    base : setpoint before and after, pv units. opened : index of the half step. whole : of the whole steps, in order.
    closed : index of the half step back, None as long as it has not come.
    """

    base: float
    opened: int
    whole: tuple[int, ...]
    closed: int | None


def step_sequence(samples: Sequence[LoopSample]) -> StepSequence | None:
    """The steps to and fro with which the newest samples of one set of gains end, None where there are none."""
    # moves of the setpoint since the gains last changed, in order
    moves: list[SetpointMove] = []
    for at in range(len(samples) - 1, 0, -1):
        if samples[at - 1].revision != samples[-1].revision:
            break
        if samples[at].sp != samples[at - 1].sp:
            moves.insert(0, SetpointMove(at, samples[at].sp - samples[at - 1].sp))
    for i in range(max(len(moves) - MOST_MOVES, 0), len(moves) - 1):
        found = _taken_for(moves[i:], samples)
        if found is not None:
            # a setpoint that moved on and on before the first of the steps is led
            reach = LED_REACH * (found.whole[0] - found.opened)
            led = i >= LED_MOVES and found.opened - moves[i - LED_MOVES].at <= reach
            return None if led else found
    return None


def _taken_for(moves: Sequence[SetpointMove], samples: Sequence[LoopSample]) -> StepSequence | None:
    half, whole, closed = moves[0].size, list[int](), None
    wanted, same = -2 * half, SAME * abs(half)
    for move in moves[1:]:
        if closed is not None:
            return None
        if abs(move.size - wanted) <= same:
            whole.append(move.at)
            wanted = -wanted
        elif whole and abs(move.size - wanted / 2) <= same:
            closed = move.at
        else:
            return None
    apart = [b - a for a, b in pairwise([move.at for move in moves])]
    if not whole or min(apart) < STANDS:
        return None
    if closed is None and len(samples) - moves[-1].at > OVERDUE * max(apart):
        return None
    return StepSequence(samples[moves[0].at - 1].sp, moves[0].at, tuple(whole), closed)
