"""A goal cut to what the limits leave: locks, absolute limits, the commissioned set, the sampling time.

Only the parameter that exceeds its limit is cut. A cut kc or tau_I changes the integral action kc/tau_I unless the
other one goes with it; which of the two is better depends on the process (an integral that must stay where hardly more
than it counts, a gain that must stay on an integrating one), so both are goals, and the proof decides. It takes the
first that holds, and the order is that of identification/robust_simc.py: does the process ask for integral action? A
limit that would push a parameter, or the integral action, the other way than was wanted leaves no room: that goal is
refused.
"""

import math
from typing import Self

from retuner.adaptive.decision_numbers import NO_NUMBERS, Numbers
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.request import ChangeRequest
from retuner.adaptive.guard.ruling import LimitNumbers, Ruling
from retuner.adaptive.guard.step_size import change_factor
from retuner.adaptive.identification.robust_simc import asks_for_integral
from retuner.schedule.gains import PidGains, series_kept
from retuner.schedule.late_dataclass import dataclass, replace


@dataclass(frozen=True, slots=True)
class Goal:
    """Gains to go to, or to prove on the way there. wanted : before they were cut, locks apart.

    notes : what was cut. cut_by, numbers : the first limit that cut it. no_room : that limit turned it back.
    On the way: aim : where it leads; share : of the whole way; whole : not half or quarter of what the limits allow;
    beyond : farther than one change may usually go, for an urgent one.
    """

    gains: PidGains
    wanted: PidGains
    tau_c_s: float
    notes: tuple[str, ...] = ()
    cut_by: Ruling | None = None
    numbers: Numbers = NO_NUMBERS
    no_room: bool = False
    aim: PidGains | None = None
    share: float = 1.0
    whole: bool = True
    beyond: bool = False

    def step(self, moved: tuple[PidGains, float], *, whole: bool, beyond: bool = False) -> Self:
        """A step on the way to these gains. moved : where it ends, and its share of the way."""
        return replace(self, gains=moved[0], aim=self.gains, share=moved[1], whole=whole, beyond=beyond)


@dataclass(frozen=True, slots=True)
class Bound:
    """A limit of a parameter: value, what it comes from, and the ruling when it leaves no room (None: never)."""

    value: float
    name: str
    ruling: Ruling | None


Cut = tuple[str, float, float, Bound | None]
"""A parameter's name, what was wanted of it, what the limits leave, and the limit that cut it."""


def goals(
    wanted: PidGains, tau_c_s: float, request: ChangeRequest, settings: GuardSettings, *, over_limit: bool
) -> list[Goal]:
    """The wanted gains within the limits: one goal, or two where kc or tau_I was cut.

    over_limit : the loop in force is over its Ms limit, so that the commissioned set does not hold it up from below.
    """
    unlocked = request.locks.keep(wanted, request.in_force)
    if unlocked.kp == 0.0 or wanted.kp == 0.0:
        return [Goal(unlocked, unlocked, tau_c_s)]
    of_kc, of_tau_i, of_tau_d = _bounds(request, settings, over_limit=over_limit)
    kc, tau_i = abs(unlocked.kp), unlocked.kp / unlocked.ki if unlocked.ki else math.inf
    tau_d = unlocked.kd / unlocked.kp
    locks = request.locks
    kc_cut, kc_by = _cut(kc, *of_kc) if not locks.kc else (kc, None)
    tau_i_cut, tau_i_by = _cut(tau_i, *of_tau_i) if unlocked.ki and not locks.tau_i else (tau_i, None)
    tau_d_cut, tau_d_by = _cut(tau_d, *of_tau_d) if tau_d and not locks.tau_d else (tau_d, None)
    least = settings.tau_d_samples * request.sample_time_s
    if tau_d and not locks.tau_d and tau_d_cut < least:  # so short a derivative is left out
        tau_d_cut, tau_d_by = 0.0, tau_d_by or Bound(least, "limit of the sampling time", None)
    cuts = [("kc", kc, kc_cut, kc_by), ("tau_I", tau_i, tau_i_cut, tau_i_by), ("tau_D", tau_d, tau_d_cut, tau_d_by)]
    held: dict[str, list[str]] = {}
    for name, was, now, by in cuts:
        if by is None:
            continue
        sign, told = (wanted.direction if name == "kc" else 1), held.setdefault(by.name, [])
        shown = "Kc" if name == "kc" else name
        told.append(f"{shown} held at {sign * now:.3g} (wanted {sign * was:.3g})")
    notes = tuple(f"{', '.join(told)}: {by}" for by, told in held.items())
    turned, cut_by, numbers = _limiting(cuts, request)
    made = _made(wanted.direction, kc_cut, tau_i_cut, tau_d_cut)
    first = Goal(made, unlocked, tau_c_s, notes, cut_by, numbers, turned)
    if turned:
        return [first]
    # As it was cut, and with the other one moved with a cut kc or tau_I, in the order to be tried
    direction = unlocked.direction
    shorter, _ = _cut(tau_i * kc_cut / kc, *of_tau_i)
    moved = replace(first, gains=_made(direction, kc_cut, shorter, tau_d_cut), notes=("tau_I moved with Kc", *notes))
    may_move = kc_cut < kc and not locks.tau_i and unlocked.ki != 0.0
    by_integral = may_move and bool(request.models) and asks_for_integral(request.models[0].model)
    found = [first]
    if tau_i_by is not None and not locks.kc:
        kept, _ = _cut(kc * tau_i_cut / tau_i, *of_kc)
        second = replace(
            first, gains=_made(direction, kept, tau_i_cut, tau_d_cut), notes=("Kc moved with tau_I", *notes)
        )
        found = [second, first] if tau_i_by.ruling is None else [first, second]
    elif may_move and not by_integral:
        found = [first, moved]
    found = [moved, *found] if by_integral else found
    return [goal if over_limit else _integral_turned(goal, request.in_force) for goal in found]


CALMER = (0.8, 0.64, 0.5, 0.35, 0.25)
"""Shares of kc, and of 1/tau_I, that are tried for a loop over its Ms limit to which the rule gives nothing else."""


def calmer(request: ChangeRequest, goal: Goal) -> list[Goal]:
    """Less of kc, or a longer tau_I alone, from what is in force, the smallest step first; within what is locked."""
    old, found = request.in_force, list[Goal]()
    for share in CALMER:
        for kp, ki in ((share, share), (1.0, share)):
            gains = request.locks.keep(PidGains(kp * old.kp, ki * old.ki, kp * old.kd), old)
            if not nothing_left(replace(goal, gains=gains), old):
                found.append(Goal(gains, gains, goal.tau_c_s, ("the rule gives nothing else: less action",)))
    return found


def _integral_turned(goal: Goal, in_force: PidGains) -> Goal:
    """No room for a goal whose cuts leave less integral action where more was wanted, or the other way round."""
    wanted, left, now = (abs(gains.ki) for gains in (goal.wanted, goal.gains, in_force))
    if goal.cut_by is None or not (wanted and left and now) or (wanted > now) == (left > now):
        return goal
    return replace(goal, no_room=goal.no_room or abs(math.log(left / now)) > SLACK)


def _sizes(gains: PidGains) -> tuple[float, float, float]:
    """kc, tau_I and tau_D; 0 for one that the controller lacks."""
    return abs(gains.kp), gains.kp / gains.ki if gains.ki else 0.0, gains.kd / gains.kp if gains.kp else 0.0


def _bounds(request: ChangeRequest, s: GuardSettings, *, over_limit: bool) -> list[tuple[Bound, Bound]]:
    """Lower and upper bounds of kc, tau_I and tau_D.

    They are the absolute ones, narrowed by the ratio to the commissioned value as far as these leave room for it, but
    not towards less action of a loop over its Ms limit. What is in force beyond the ratio may stay, but go no farther.
    """
    outside, sampling = Ruling.OUTSIDE_LIMITS, "limit of the sampling time"
    starts, in_force = _sizes(request.commissioned), _sizes(request.in_force)
    floor = min(s.tau_i_samples * request.sample_time_s, in_force[1] or math.inf)
    shortest = Bound(floor, sampling, None) if floor > s.tau_i_min_s else Bound(s.tau_i_min_s, "tau_i_min", outside)
    absolute = (
        (Bound(s.kc_min, "kc_min", outside), Bound(s.kc_max, "kc_max", outside)),
        (shortest, Bound(s.tau_i_max_s, "tau_i_max", outside)),
        (Bound(0.0, "no limit", None), Bound(s.tau_d_max_s, "tau_d_max", outside)),
    )
    ratio, found = s.total_ratio_max, []
    name = f"at most {ratio:g}x baseline. Raise total_ratio_max or accept the new baseline."
    for limits, start, now, longer_is_less in zip(absolute, starts, in_force, (False, True, False), strict=True):
        low, high = limits
        most, least = max(start * ratio, now), min(start / ratio, now or math.inf)
        if start and not (over_limit and longer_is_less) and most < high.value:
            high = Bound(max(most, low.value), name, Ruling.OUTSIDE_TOTAL)
        if start and (longer_is_less or not over_limit) and low.value < least:
            low = Bound(min(least, high.value), name, Ruling.OUTSIDE_TOTAL)
        found.append((low, high))
    return found


def without_short_derivative(gains: PidGains, request: ChangeRequest, settings: GuardSettings) -> PidGains:
    """Gains on the way to a goal, without a derivative too short for the sampling time, or longer than series has."""
    if request.locks.tau_d or not gains.kp or not gains.kd:
        return gains
    least = settings.tau_d_samples * request.sample_time_s * (1 - TOLERANCE)
    return series_kept(gains, request.in_force) if gains.kd / gains.kp >= least else PidGains(gains.kp, gains.ki)


def _cut(value: float, low: Bound, high: Bound) -> tuple[float, Bound | None]:
    if value > high.value:
        return high.value, high
    return (low.value, low) if value < low.value else (value, None)


def _made(direction: int, kc: float, tau_i: float, tau_d: float) -> PidGains:
    return PidGains(direction * kc, direction * kc / tau_i, direction * kc * tau_d)


def _limiting(cuts: list[Cut], request: ChangeRequest) -> tuple[bool, Ruling | None, Numbers]:
    """The bound that pushes a parameter away from where it was to go, or else the first that cuts one; and which."""
    first: tuple[bool, Ruling | None, Numbers] = (False, None, NO_NUMBERS)
    for (_, wanted, cut, by), start in zip(cuts, _sizes(request.in_force), strict=True):
        if by is None or by.ruling is None:
            continue
        numbers = LimitNumbers(wanted, by.value)
        turned = start > 0 and (wanted > start) != (cut > start)
        if turned and (not cut or abs(math.log(cut / start)) > SLACK):
            return True, by.ruling, numbers
        first = first if first[1] else (False, by.ruling, numbers)
    return first


TOLERANCE = 1e-9  # rounding of a derivative that is as short as it may be
SLACK = math.log(1.001)
"""A limit that the parameter in force exceeds by no more than rounding on the controller's side is not exceeded."""


def nothing_left(goal: Goal, in_force: PidGains) -> bool:
    """Whether what is left of the goal is what is in force already."""
    return change_factor(in_force, goal.gains) < math.exp(SLACK)
