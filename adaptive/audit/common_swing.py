"""Loops that swing together: one period, and which of them it likely comes from.

Loops whose periods agree within SAME_PERIOD form a group; nothing but the period is compared. A disturbance that is
passed on is filtered on its way, so its harmonics are strongest at its source (Thornhill, Cox & Paulonis 2003): the
root is the loop with a valve that sticks, where one is known, else the one with the largest share of third harmonic.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

SAME_PERIOD = 0.04
"""Difference of two periods, as a share, below which they are one."""
LOUDER = 1.3
"""Ratio of harmonics from which the loudest loop is named as the root."""


@dataclass(frozen=True, slots=True)
class Swinging:
    """A loop that swings.

    tag : of the loop. period_s : of the swing. harmonic : amplitude of the third harmonic over the first, 0 to 1.
    sticks : its valve is said to stick. own : its own tuning is said to be the cause.
    """

    tag: str
    period_s: float
    harmonic: float
    sticks: bool = False
    own: bool = False


@dataclass(frozen=True, slots=True)
class CommonSwing:
    """A group: its period, its loops (the likely root first), and why that one; root is None where none stands out."""

    period_s: float
    tags: tuple[str, ...]
    root: str | None
    why: str


def common_swings(loops: Sequence[Swinging]) -> list[CommonSwing]:
    """Groups of two loops or more, the largest first."""
    groups: list[list[Swinging]] = []
    for loop in sorted(loops, key=lambda one: one.period_s):
        if groups and loop.period_s <= groups[-1][-1].period_s * (1 + SAME_PERIOD):
            groups[-1].append(loop)
        else:
            groups.append([loop])
    found = [_group(group) for group in groups if len(group) > 1]
    return sorted(found, key=lambda group: -len(group.tags))


def _group(loops: Sequence[Swinging]) -> CommonSwing:
    """One group with its root."""
    root, why = _root(loops)
    others = [loop.tag for loop in sorted(loops, key=lambda one: -one.harmonic) if loop.tag != root]
    period_s = sorted(loop.period_s for loop in loops)[len(loops) // 2]
    return CommonSwing(period_s, (*([root] if root else []), *others), root, why)


def _root(loops: Sequence[Swinging]) -> tuple[str | None, str]:
    """Where the swing likely comes from."""
    sticking = sorted((one for one in loops if one.sticks), key=lambda one: -one.harmonic)
    if sticking:
        return sticking[0].tag, "its valve sticks"
    own = [one for one in loops if one.own]
    if len(own) == 1:
        return own[0].tag, "its tuning makes it oscillate"
    loudest, second = sorted(loops, key=lambda one: -one.harmonic)[:2]
    if loudest.harmonic > LOUDER * second.harmonic:
        return loudest.tag, "its harmonics are the strongest: what is passed on is filtered"
    return None, "none stands out"


def grouped(groups: Sequence[CommonSwing]) -> Mapping[str, CommonSwing]:
    """The group of each loop that is in one."""
    return {tag: group for group in groups for tag in group.tags}
