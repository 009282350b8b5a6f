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
    limits = _Limits(request, settings, over_limit)
    kc, tau_i = abs(unlocked.kp), unlocked.kp / unlocked.ki if unlocked.ki else math.inf
    tau_d = unlocked.kd / unlocked.kp
    locks = request.locks
    kc_cut, kc_by = _cut(kc, *limits.kc()) if not locks.kc else (kc, None)
    tau_i_cut, tau_i_by = _cut(tau_i, *limits.tau_i()) if unlocked.ki and not locks.tau_i else (tau_i, None)
    tau_d_cut, tau_d_by = limits.cut_tau_d(tau_d)
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
    shorter, _ = _cut(tau_i * kc_cut / kc, *limits.tau_i())
    moved = replace(first, gains=_made(direction, kc_cut, shorter, tau_d_cut), notes=("tau_I moved with Kc", *notes))
    may_move = kc_cut < kc and not locks.tau_i and unlocked.ki != 0.0
    by_integral = may_move and bool(request.models) and asks_for_integral(request.models[0].model)
    found = [first]
    if tau_i_by is not None and not locks.kc:
        kept, _ = _cut(kc * tau_i_cut / tau_i, *limits.kc())
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


class _Limits:
    """Lower and upper bounds of the parameters for one request."""

    def __init__(self, request: ChangeRequest, settings: GuardSettings, over_limit: bool) -> None:
        self._request, self._settings, self._over = request, settings, over_limit

    def kc(self) -> tuple[Bound, Bound]:
        s, start, now = self._settings, abs(self._request.commissioned.kp), abs(self._request.in_force.kp)
        low = Bound(s.kc_min, "kc_min", Ruling.OUTSIDE_LIMITS)
        high = Bound(s.kc_max, "kc_max", Ruling.OUTSIDE_LIMITS)
        return self._with_total(low, high, (start, now), down=not self._over, up=True)

    def tau_i(self) -> tuple[Bound, Bound]:
        s = self._settings
        start, now = (g.kp / g.ki if g.ki else 0.0 for g in (self._request.commissioned, self._request.in_force))
        floor = min(s.tau_i_samples * self._request.sample_time_s, now or math.inf)
        low = Bound(s.tau_i_min_s, "tau_i_min", Ruling.OUTSIDE_LIMITS)
        if floor > low.value:
            low = Bound(floor, "limit of the sampling time", None)
        high = Bound(s.tau_i_max_s, "tau_i_max", Ruling.OUTSIDE_LIMITS)
        return self._with_total(low, high, (start, now), down=True, up=not self._over)

    def cut_tau_d(self, tau_d: float) -> tuple[float, Bound | None]:
        """A derivative shorter than its least share of the sampling time is left out."""
        s = self._settings
        if self._request.locks.tau_d or tau_d == 0.0:
            return tau_d, None
        least = s.tau_d_samples * self._request.sample_time_s
        start, now = (g.kd / g.kp if g.kp else 0.0 for g in (self._request.commissioned, self._request.in_force))
        high = Bound(s.tau_d_max_s, "tau_d_max", Ruling.OUTSIDE_LIMITS)
        low = Bound(0.0, "no limit", None)
        found, by = _cut(tau_d, *self._with_total(low, high, (start, now), down=not self._over, up=True))
        return (0.0, by or Bound(least, "limit of the sampling time", None)) if found < least else (found, by)

    def _with_total(
        self, low: Bound, high: Bound, values: tuple[float, float], *, down: bool, up: bool
    ) -> tuple[Bound, Bound]:
        """Narrowed by the ratio to the commissioned value, as far as the absolute limits leave room for that.

        values : commissioned and in force. What is in force beyond the ratio may stay there, but go no farther.
        """
        start, now = values
        ratio = self._settings.total_ratio_max
        name = f"at most {ratio:g}x baseline. Raise total_ratio_max or accept the new baseline."
        most, least = max(start * ratio, now), min(start / ratio, now or math.inf)
        if start and up and most < high.value:
            high = Bound(max(most, low.value), name, Ruling.OUTSIDE_TOTAL)
        if start and down and low.value < least:
            low = Bound(min(least, high.value), name, Ruling.OUTSIDE_TOTAL)
        return low, high


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
    old = request.in_force
    now = {
        "kc": abs(old.kp),
        "tau_I": old.kp / old.ki if old.kp and old.ki else 0.0,
        "tau_D": old.kd / old.kp if old.kp else 0.0,
    }
    first: tuple[bool, Ruling | None, Numbers] = (False, None, NO_NUMBERS)
    for name, wanted, cut, by in cuts:
        if by is None or by.ruling is None:
            continue
        start, numbers = now[name], LimitNumbers(wanted, by.value)
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
