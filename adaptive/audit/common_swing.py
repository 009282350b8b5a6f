"""Loops that swing together: one period, one phase, and which of them it likely comes from.

Loops are of one group where their periods are alike and their swings coherent (tracks.py); where the records have
nothing in common but their periods, periods within SAME_PERIOD must do. The likely root, first hint first:

    the valve that sticks most surely         a valve makes a swing out of nothing; two in step would be a wonder
    the one loop whose own tuning swings
    the strongest third harmonic              what is passed on is filtered (Thornhill, Cox & Paulonis 2003)

Where several loops' tuning swings, or of two loops nothing is bent, they swing against each other: an interaction. So
do two that read as too strong each by itself and whose oscillations after every upset keep step, though they die away.
Which is earlier is not asked: feedback turns the phase of the error; roots came a fifth of a period before or after.
"""

from collections.abc import Sequence

from retuner.adaptive.audit.tracks import SwingTrack, by_chance, coherence
from retuner.schedule.late_dataclass import dataclass

SAME_PERIOD = 0.04  # difference of two periods, as a share, below which they are one where nothing else can be compared
LIKE_PERIOD = 0.08  # LIKE_PERIOD where the swings are coherent: their periods are known to some per cent
COHERENT = 0.5  # coherence from which two loops swing together
LOUDER = 1.3  # ratio of harmonics from which the loudest loop is named as the root
STICKS = 0.2  # what its stretches must say of a valve for it to be the root
BENT = 0.05  # third harmonic over the first, from which something in a loop is not linear
ONE_MODE = 1.6
"""Ratio of the periods that two loops seem to have by themselves, up to which they may be one oscillation."""
UNLIKELY = 1e-5  # odds by chance below which two loops that are compared among many keep step
AGAINST = "after every upset they oscillate in step, and each by itself reads as too strong: they act on each other"


@dataclass(frozen=True, slots=True)
class Swinging:
    """A loop that swings.

    tag : of the loop. period_s : of the swing. harmonic : amplitude of the third harmonic over the first, 0 to 1.
    sticks : how far its stretches say that its valve sticks, 0 to 1. own : its own tuning is said to be the cause.
    track : of its swing over time.
    """

    tag: str
    period_s: float
    harmonic: float
    sticks: float = 0.0
    own: bool = False
    track: SwingTrack | None = None


@dataclass(frozen=True, slots=True)
class CommonSwing:
    """A group: its period, its loops (the likely root first), and why that one; root is None where none stands out.

    interaction : its loops swing against each other. coherence : of the loops with the first one, the median; None
    where only their periods could be compared.
    """

    period_s: float
    tags: tuple[str, ...]
    root: str | None
    why: str
    interaction: bool = False
    coherence: float | None = None


def common_swings(loops: Sequence[Swinging]) -> list[CommonSwing]:
    """Groups of two loops or more, the largest first."""
    ordered = sorted(loops, key=lambda one: one.period_s)
    group_of = list(range(len(ordered)))
    for i, loop in enumerate(ordered):
        for j in range(i + 1, len(ordered)):
            if ordered[j].period_s > loop.period_s * (1 + LIKE_PERIOD):
                break
            one, other = _first(group_of, i), _first(group_of, j)
            if one != other and together(loop, ordered[j]):
                group_of[other] = one
    groups: dict[int, list[Swinging]] = {}
    for i, loop in enumerate(ordered):
        groups.setdefault(_first(group_of, i), []).append(loop)
    found = [_group(group) for group in groups.values() if len(group) > 1]
    return sorted(found, key=lambda group: (-len(group.tags), group.period_s))


def interactions(loops: Sequence[Swinging]) -> list[CommonSwing]:
    """Loops that act on each other, though what they make dies away. loops : each named as too strong by itself."""
    ordered = sorted(loops, key=lambda one: one.period_s)
    tracked = [(one, one.track) for one in ordered if one.track is not None]
    found = []
    for i, (loop, track) in enumerate(tracked):
        for other, its in tracked[i + 1 :]:
            if other.period_s > ONE_MODE * loop.period_s:
                break
            told = coherence(track, its)
            if told is not None and told[0] >= COHERENT and by_chance(track, its) < UNLIKELY:
                tags = tuple(sorted((loop.tag, other.tag)))
                found.append(CommonSwing(loop.period_s, tags, None, AGAINST, interaction=True, coherence=told[0]))
    return found


def _first(group_of: list[int], i: int) -> int:
    """The loop that stands for the group of loop i."""
    while group_of[i] != i:
        group_of[i] = i = group_of[group_of[i]]
    return i


def together(a: Swinging, b: Swinging) -> bool:
    """Whether two loops swing together."""
    told = _told(a, b)
    if told is not None:
        return told[0] >= COHERENT
    apart = abs(a.period_s - b.period_s) > SAME_PERIOD * min(a.period_s, b.period_s)
    return not apart and (a.track is None) == (b.track is None)


def _group(loops: Sequence[Swinging]) -> CommonSwing:
    root, why, interaction = _root(loops)
    ordered = sorted(loops, key=lambda one: (one.tag != root, -one.harmonic))
    told = [_told(ordered[0], one) for one in ordered[1:]]
    known = sorted(t[0] for t in told if t is not None)
    period_s = sorted(loop.period_s for loop in loops)[len(loops) // 2]
    middle = known[len(known) // 2] if known else None
    return CommonSwing(period_s, tuple(one.tag for one in ordered), root, why, interaction, middle)


def _told(a: Swinging, b: Swinging) -> tuple[float, float] | None:
    """Coherence and delay of two loops, where they are known."""
    return coherence(a.track, b.track) if a.track is not None and b.track is not None else None


def _root(loops: Sequence[Swinging]) -> tuple[str | None, str, bool]:
    """Where the swing likely comes from, why, and whether the loops swing against each other."""
    surest = max(loops, key=lambda one: (one.sticks, one.harmonic))
    if surest.sticks >= STICKS:
        return surest.tag, "its valve sticks", False
    own = [one for one in loops if one.own]
    if len(own) == 1:
        return own[0].tag, "its tuning makes it oscillate", False
    if own:
        return None, "the tuning of several makes them oscillate against each other; slow one down and look again", True
    loudest, second = sorted(loops, key=lambda one: -one.harmonic)[:2]
    if loudest.harmonic > max(LOUDER * second.harmonic, BENT):
        return loudest.tag, "its harmonics are the strongest, and harmonics are filtered on the way to others", False
    if loudest.harmonic < BENT:
        why = "none of them is nonlinear: they oscillate against each other, or the source is not among these loops"
        return None, why, len(loops) == 2
    return None, "none stands out", False
