"""Proof before change: what a proposed set of gains must pass before it may reach a controller.

    direction, numbers -> evidence -> locks, limits, commissioned set, sampling -> size of the step
                       -> Ms on the process <= ms_nominal, Ms on every model that the records allow <= ms_worst
                       -> the same on both sides of every boundary of the region, and between the knots of a mean

The remedies come in this order: a larger tau_c (to tau_c_max_ratio theta), a half step, a quarter step, refusal. Steps
are taken in the logarithms, so that a half step lies between old and new in every form. A loop that is itself over a
limit may always be made safer, by a step as small as it must be: no dead band, no lower limit from the commissioned
set. One that is over it on every allowed model oscillates, or nearly; it may take the whole step in the safe direction
at once. The same holds for a measured oscillation, and where the models do not confirm it, only less of everything
counts as safe. Gains that fail any check but Ms are no candidates: an accepted change shows no failed check.
Everything is deterministic, so that replay decides alike.
"""

import math
from collections.abc import Iterator, Sequence

from retuner.adaptive.decision_numbers import NO_NUMBERS, Numbers
from retuner.adaptive.guard.both_sides_of_boundary import at_boundary, no_worse
from retuner.adaptive.guard.checks import evidence_checks, failed_checks, limit_checks, robustness_checks
from retuner.adaptive.guard.goal_within_limits import Goal, calmer, goals, nothing_left, without_short_derivative
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.request import ChangeRequest, NeighbourBoundary, Support
from retuner.adaptive.guard.ruling import (
    BoundaryNumbers,
    Check,
    DoubtNumbers,
    FactorNumbers,
    LimitNumbers,
    NotRobustNumbers,
    Proof,
    ProofNumbers,
    Ruling,
    SignNumbers,
    WantedNumbers,
)
from retuner.adaptive.guard.step_size import change_factor, extent, less_of_everything, within_factor, within_limits
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.rules.rule import ControllerKind, Tuning
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace

# A set of gains is safer than another when, on the allowed models that are stable with either,
#
#     Ms falls on the process, falls at worst, and rises on no model,
#
# and no model that was stable becomes unstable. On a model that is unstable before and after (the largest step that the
# limits allow is not enough) Ms does not say which is better. There the direction does: less of everything, which slows
# the run away on any process; or a step on the straight way to a goal that is stable there.


class MsOnModels:
    """Ms of sets of gains on several processes, the first the one identified.

    filter_s : filter time of the controller's derivative.
    """

    def __init__(self, processes: Sequence[LinearProcess], filter_s: float = 0.0) -> None:
        self._processes, self._filter_s = tuple(processes), filter_s
        self._order = list(range(len(self._processes)))

    def __len__(self) -> int:
        return len(self._processes)

    def ms(self, i: int, gains: PidGains) -> float:
        """Ms on one process, infinite when unstable."""
        return sensitivity_peak(self._processes[i], gains, self._filter_s)

    def nominal(self, gains: PidGains) -> float:
        """Ms on the process, NaN when no model is known."""
        return self.ms(0, gains) if self._processes else math.nan

    def worst(self, gains: PidGains) -> float:
        """Largest Ms, NaN when no model is known."""
        return max((self.ms(i, gains) for i in range(len(self))), default=math.nan)

    def within(self, gains: PidGains, nominal: float, worst: float) -> bool:
        """Whether Ms keeps both limits; stops at the first model that does not, which is asked first next time."""
        if self.nominal(gains) > nominal:
            return False
        for place, i in enumerate(self._order):
            if self.ms(i, gains) > worst:
                self._order.insert(0, self._order.pop(place))
                return False
        return True

    def safer(self, old: PidGains, new: PidGains, goal: PidGains) -> bool:
        """Whether new is safer than old (see above this class); goal : where the step leads."""
        pairs = [(self.ms(i, old), self.ms(i, new)) for i in range(len(self))]
        if not pairs or any(after > before for before, after in pairs):
            return False
        unstable = [i for i, (before, after) in enumerate(pairs) if math.isinf(before) and math.isinf(after)]
        if unstable:
            return less_of_everything(old, new) or all(math.isfinite(self.ms(i, goal)) for i in unstable)
        return pairs[0][1] < pairs[0][0] and max(after for _, after in pairs) < max(before for before, _ in pairs)


# The rule's own settings at larger tau_c: the first remedy for what is not robust.

STEPS = 3  # equal ratios from the proposal's tau_c to the largest
RULE = "simc"  # the rule whose settings the guard can find by itself


def slower_settings(request: ChangeRequest, settings: GuardSettings) -> Sequence[Tuning]:
    """Settings in order of tau_c, up to tau_c_max_ratio (effective) dead times; none for rules without tau_c."""
    wanted = request.proposal
    if request.slower or wanted.rule != RULE or wanted.tau_c_s is None or not request.models:
        return request.slower
    best = request.models[0].model
    model = best.seen_by_controller(request.sample_time_s)
    kind = ControllerKind.PID if wanted.gains.kd else ControllerKind.PI
    theta = (model.of_second_order() if kind == ControllerKind.PID else without_second_lag(model)).theta_s
    whole = theta * settings.tau_c_max_ratio / wanted.tau_c_s
    if whole <= 1.0:
        return ()
    return [simc(model, wanted.tau_c_s * whole ** (i / STEPS), kind) for i in range(1, STEPS + 1)]


CALMED = 0.98  # A change must bring an Ms that is over its limit between two knots down to this share of it
SHARES = (1.0, 0.5, 0.25)  # Full, half and quarter step
SHORT_OF_LIMIT = (1.0, 1.0 - 1e-6, 0.99, 0.95, 0.9)  # shares of a step that are tried where the controller rounds


@dataclass(slots=True)
class _Case:
    request: ChangeRequest
    settings: GuardSettings
    on_models: MsOnModels
    at_boundary: Check | None = None
    outside: Check | None = None
    asked: dict[tuple[str, PidGains], tuple[float, bool]] = field(default_factory=dict)
    over: bool = field(init=False)
    between: float = field(init=False)
    oscillates: bool = field(init=False)

    def __post_init__(self) -> None:
        old, s = self.request.in_force, self.settings
        self.between = self.most_between(old)
        models = range(len(self.on_models))
        over = bool(models) and not self.on_models.within(old, s.ms_nominal, s.ms_worst)
        self.oscillates = over and all(self.on_models.ms(i, old) > s.ms_worst for i in models)
        self.over = over or self.between > s.ms_border

    def most_between(self, gains: PidGains) -> float:
        """Largest Ms between the knots of an interpolated table with these gains; 0 where nothing is known to ask."""
        asked = [self.at(boundary, gains)[0] for boundary in self.request.boundaries if boundary.interpolated]
        return max((ms for ms in asked if not math.isnan(ms)), default=0.0)

    def at(self, boundary: NeighbourBoundary, gains: PidGains) -> tuple[float, bool]:
        """Ms at a boundary, and whether it is proved there; asked once."""
        key, (limit, asked) = (boundary.name, gains), (self.settings.ms_border, self.request)
        if key not in self.asked:
            loop = asked.sample_time_s, asked.filter_s
            self.asked[key] = at_boundary(boundary, asked.models, gains, asked.in_force, limit, *loop)
        return self.asked[key]

    @property
    def urgent(self) -> bool:
        return self.request.urgent or self.oscillates


def prove(request: ChangeRequest, settings: GuardSettings) -> Proof:
    """Decide what may be written; see the head of this file."""
    processes = [p.model.seen_by_controller(request.sample_time_s).linear() for p in request.models]
    case = _Case(request, settings, MsOnModels(processes, request.filter_s))
    doubt = _entry_doubt(request, settings)
    if doubt is not None and not (doubt[0] in EVIDENCE and (case.over or request.urgent)):
        return _refused(case, *doubt)
    open_goals, refusal = _open_goals(case)
    if refusal is not None:
        return refusal
    if not request.models:
        return _unproved(case, open_goals[0])
    tried = list(_candidates(case, open_goals))
    if doubt is not None:
        tried = [c for c in tried if less_of_everything(request.in_force, c.gains)]
    return _best(case, tried, doubt is not None) or _refused(case, *(doubt or _why_not(case, tried)))


UNPROVED = {False: Ruling.UNPROVED_STEP, True: Ruling.UNPROVED_WAY_OUT}
"""Ruling of a change without a model: not urgent, urgent."""
DOUBTS = {
    "records": (Ruling.TOO_FEW_RECORDS, "records"),
    "age": (Ruling.TOO_OLD, "age_s"),
    "innovation": (Ruling.CONTRADICTED, "innovation"),
    "settled": (Ruling.NOT_SETTLED, "settled"),
}
"""Ruling of a check of the evidence that failed, and the name of its number."""
EVIDENCE = frozenset(ruling for ruling, _ in DOUBTS.values())
"""Doubts that leave the way to less of everything open for a loop over its limit."""


def _entry_doubt(request: ChangeRequest, settings: GuardSettings) -> tuple[Ruling, Numbers] | None:
    """What speaks against a change before it is looked at: its direction, its numbers, the evidence behind it."""
    wanted = request.proposal
    if wanted.gains.direction != request.in_force.direction:
        return Ruling.WRONG_SIGN, SignNumbers(float(wanted.gains.direction), float(request.in_force.direction))
    ratios = [a / b for a, b in ((wanted.gains.kp, wanted.gains.ki), (wanted.gains.kd, wanted.gains.kp)) if a and b]
    if not all(0 < ratio < math.inf for ratio in ratios) or not math.isfinite(wanted.tau_c_s or 0.0):
        return Ruling.NOT_FINITE, WantedNumbers(wanted.gains.kp)
    if not request.models and request.evidence.support is Support.MODEL:
        return Ruling.NO_MODEL, NO_NUMBERS
    for check in evidence_checks(request, settings):
        if not check.passed:
            ruling, name = DOUBTS[check.name]
            return ruling, DoubtNumbers(check.limit, **{name: check.value})
    return None


def _open_goals(case: _Case) -> tuple[list[Goal], Proof | None]:
    """The goals that are worth a write, or why there is none.

    Where kc stands at its limit already, a goal that moves tau_I alone is one; what the rule would give at a larger
    tau_c is none by itself. For a loop over its Ms limit to which the rule gives nothing else there are calmer
    settings than those in force.
    """
    tunings = (case.request.proposal, *slower_settings(case.request, case.settings))
    wanted = [
        goal
        for t in tunings
        for goal in goals(t.gains, t.tau_c_s or 0.0, case.request, case.settings, over_limit=case.over)
    ]
    room = [goal for goal in wanted if not goal.no_room]
    small = [_too_small(case, goal) for goal in room if goal.wanted == room[0].wanted]
    if None in small:
        return room[small.index(None) :], None
    less = calmer(case.request, wanted[0]) if case.over and case.request.models else []
    if less:
        return less, None
    if not room:
        return [], _refused(case, wanted[0].cut_by or Ruling.OUTSIDE_LIMITS, wanted[0].numbers, wanted[0].notes)
    assert small[0] is not None  # a None among them has returned above
    if case.over and small[0][0] is Ruling.TOO_SMALL:
        return [], _refused(case, *_not_robust(case, case.request.in_force), room[0].notes)
    return [], _refused(case, *small[0], room[0].notes)


def _too_small(case: _Case, goal: Goal) -> tuple[Ruling, Numbers] | None:
    """Why nothing worth a write is left of the goal, if so."""
    request, wanted = case.request, case.request.proposal.gains
    factor, wish = change_factor(request.in_force, goal.gains), change_factor(request.in_force, wanted)
    limit = case.settings.smallest_change
    if case.over and not nothing_left(goal, request.in_force):
        return None
    if factor >= limit:
        return None
    if goal.cut_by is not None:
        return goal.cut_by, goal.numbers
    if wish >= limit and not goal.notes:
        return Ruling.LOCKED, FactorNumbers(wish)
    return Ruling.TOO_SMALL, FactorNumbers(factor, limit)


def _candidates(case: _Case, wanted: list[Goal]) -> Iterator[Goal]:
    """What to prove, in order: whole steps at every tau_c, then half and quarter steps to the slowest goal."""
    old, s = case.request.in_force, case.settings
    if case.urgent:
        for goal in wanted:
            moved = within_limits(old, goal.gains, 1.0, s, less_unlimited=True)
            if moved is not None and _safe_direction(case, moved[0], goal.gains):
                yield from _inside(case, goal.step(moved, whole=True, beyond=True))
    for share in SHARES:
        for goal in wanted if share == 1.0 else wanted[-1:]:
            moved = within_limits(old, goal.gains, share, s)
            if moved is not None:
                yield from _inside(case, goal.step(moved, whole=share == 1.0))


def _inside(case: _Case, candidate: Goal) -> Iterator[Goal]:
    """The candidate as the controller would hold it, if it keeps every limit; remembers the first that one did not.

    Rounding may carry a step past a limit that it was cut to, so one that is rounded may stop a little short of it.
    """
    request = case.request
    for short in SHORT_OF_LIMIT if request.units is not None else (1.0,):
        old, nearer = request.in_force, candidate.gains
        if short != 1.0:
            pairs = ((old.kp, nearer.kp), (old.ki, nearer.ki), (old.kd, nearer.kd))
            nearer = PidGains(*(o + short * (n - o) for o, n in pairs))
        gains = request.rounded(without_short_derivative(nearer, request, case.settings))
        if gains is None:
            continue
        checks = limit_checks(request, gains, case.settings, over_limit=case.over, urgent=candidate.beyond)
        failed = next((check for check in checks if not check.passed), None)
        case.outside = case.outside or failed
        if failed is None:
            yield replace(candidate, gains=gains)
            return


def _safe_direction(case: _Case, gains: PidGains, aim: PidGains) -> bool:
    """Whether a step is one that an oscillating loop may take at once."""
    old = case.request.in_force
    return less_of_everything(old, gains) if not case.over else case.on_models.safer(old, gains, aim)


def _best(case: _Case, tried: list[Goal], doubted: bool) -> Proof | None:
    """The first candidate that is proved; else, for a loop over its limit, the largest step that makes it safer.

    That step is tried at the slowest tau_c first.
    """
    s, on_models, old = case.settings, case.on_models, case.request.in_force
    for candidate in () if doubted else tried:
        factor = change_factor(old, candidate.gains)
        if factor < s.smallest_change and not case.over:
            if candidate.whole:
                return _refused(case, Ruling.TOO_SMALL, FactorNumbers(factor, s.smallest_change))
            continue
        if on_models.within(candidate.gains, s.ms_nominal, s.ms_worst) and _boundaries_hold(case, candidate.gains):
            return _accepted(case, candidate, Ruling.URGENT if candidate.beyond else Ruling.ACCEPTED)
    if not case.over:
        return None
    by_safety = sorted(tried, key=lambda c: (not c.beyond, not c.whole, -c.tau_c_s, -c.share))
    for candidate in by_safety:
        gains = candidate.gains
        if on_models.safer(old, gains, candidate.aim or gains) and _boundaries_hold(case, gains):
            return _accepted(case, candidate, Ruling.SAFER)
    return None


def _boundaries_hold(case: _Case, gains: PidGains) -> bool:
    """Whether all boundaries are proved, and what was too much between knots is less; keeps the first that is not."""
    for boundary in case.request.boundaries:
        check = _boundary_check(case, boundary, gains)
        if check is not None and not check.passed:
            case.at_boundary = case.at_boundary or check
            return False
    limit = case.settings.ms_border
    if case.between <= limit:
        return True
    return no_worse(case.most_between(gains), max(limit, case.between * CALMED), case.request.in_force, gains)


def _boundary_check(case: _Case, boundary: NeighbourBoundary, gains: PidGains) -> Check | None:
    ms, passed = case.at(boundary, gains)
    words = f"Ms at the boundary to region {boundary.name} (or no worse than before)"
    return None if math.isnan(ms) else Check("ms_border", words, ms, case.settings.ms_border, passed)


def _why_not(case: _Case, tried: list[Goal]) -> tuple[Ruling, Numbers]:
    """The refusal of the gentlest candidate, with its numbers."""
    s = case.settings
    if not tried:
        return _outside(case)
    gains = tried[-1].gains
    if case.at_boundary is not None and case.on_models.within(gains, s.ms_nominal, s.ms_worst):
        return Ruling.NOT_ROBUST_AT_BORDER, BoundaryNumbers(case.at_boundary.value, case.at_boundary.limit)
    return _not_robust(case, gains)


def _not_robust(case: _Case, gains: PidGains) -> tuple[Ruling, Numbers]:
    s, tried_ms = case.settings, (case.on_models.nominal(gains), case.on_models.worst(gains))
    return Ruling.NOT_ROBUST, NotRobustNumbers(*tried_ms, s.ms_nominal, s.ms_worst)


def _outside(case: _Case) -> tuple[Ruling, Numbers]:
    if case.outside is not None:
        return Ruling.OUTSIDE_LIMITS, LimitNumbers(case.outside.value, case.outside.limit)
    return Ruling.OUTSIDE_LIMITS, LimitNumbers(abs(case.request.proposal.gains.kp), case.settings.kc_max)


def _share(old: PidGains, new: PidGains, goal: Goal) -> float:
    """How much of the way that was wanted has been gone, in the parameter that goes farthest."""
    whole = extent(old, goal.wanted)
    return min(extent(old, new) / whole, 1.0) if whole and new != goal.wanted else 1.0


def _unproved(case: _Case, goal: Goal) -> Proof:
    """A small step where no model can prove one, the pattern's; the whole one where an oscillation asks for less."""
    request, s = case.request, case.settings
    way_out = request.urgent and less_of_everything(request.in_force, goal.gains)
    limit = math.inf if way_out else s.pattern_step_max
    wanted = without_short_derivative(within_factor(request.in_force, goal.gains, limit), request, s)
    gains = request.rounded(wanted)
    if gains is None:
        return _refused(case, *_outside(case), goal.notes)
    numbers = FactorNumbers(change_factor(request.in_force, gains), limit if math.isfinite(limit) else None)
    checks = tuple(limit_checks(request, gains, s, factor=limit))
    case.outside = next((check for check in checks if not check.passed), None)
    if case.outside is not None:
        return _refused(case, *_outside(case), goal.notes)
    step, ms = _share(request.in_force, gains, goal), (math.nan,) * 3
    return Proof(UNPROVED[way_out], gains, step, *ms, goal.tau_c_s, numbers, checks, goal.notes, (), way_out)


def _accepted(case: _Case, candidate: Goal, ruling: Ruling) -> Proof:
    request, s, on_models, gains = case.request, case.settings, case.on_models, candidate.gains
    nominal, worst = on_models.nominal(gains), on_models.worst(gains)
    before, before_worst = on_models.nominal(request.in_force), on_models.worst(request.in_force)
    told = before_worst if ruling == Ruling.SAFER else None
    numbers = ProofNumbers(nominal, worst, before, float(len(on_models)), told)
    boundaries = (_boundary_check(case, boundary, gains) for boundary in request.boundaries)
    checks = (
        *evidence_checks(request, s, less=less_of_everything(request.in_force, gains)),
        *limit_checks(request, gains, s, over_limit=case.over, urgent=candidate.beyond),
        *robustness_checks((nominal, worst), (before, before_worst), s),
        *(check for check in boundaries if check is not None),
    )
    urgent = case.urgent and _safe_direction(case, gains, candidate.aim or gains)
    step = _share(request.in_force, gains, candidate)
    return Proof(
        ruling, gains, step, nominal, worst, before, candidate.tau_c_s, numbers, checks, candidate.notes,
        tuple(request.models), urgent,
    )  # fmt: skip


def _refused(case: _Case, ruling: Ruling, numbers: Numbers, notes: tuple[str, ...] = ()) -> Proof:
    request = case.request
    nominal, worst = case.on_models.nominal(request.in_force), case.on_models.worst(request.in_force)
    checks = (*evidence_checks(request, case.settings), *failed_checks(numbers))
    return Proof(
        ruling, None, 0.0, nominal, worst, nominal, request.proposal.tau_c_s or 0.0, numbers, checks, notes,
        tuple(request.models), False,
    )  # fmt: skip
