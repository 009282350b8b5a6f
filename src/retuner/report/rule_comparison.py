"""Every tuning rule that applies to a process, side by side: settings, robustness and performance."""

import math

from retuner.adaptive.loop.optimum import references
from retuner.adaptive.loop.performance import Performance, performance, weighted_cost
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.registry import RULES, kind_for
from retuner.adaptive.rules.rule import ControllerKind, Takes
from retuner.schedule.late_dataclass import dataclass
from retuner.tuning import TuneResult, tune

OPTION_OF_WISH = {"tau_c_s": "tau_c"}  # argument of tune() for those wishes whose field has another name
READINGS = {Takes.ULTIMATE: ("ku", "pu"), Takes.QUARTER_DECAY: ("kq", "pq"), Takes.MODEL: ()}


@dataclass(frozen=True, slots=True)
class RuleRow:
    """One rule's settings with what they do; j is None where there are no reference controllers to compare with."""

    result: TuneResult
    performance: Performance
    j: float | None

    def to_dict(self) -> dict[str, object]:
        """The result's keys and iae_setpoint, iae_load, tv_setpoint, tv_load, j."""
        return {**self.result.to_dict(), **self.performance.to_dict(), "j": self.j}


@dataclass(frozen=True, slots=True)
class Comparison:
    """rows : the rules that have an answer. left_out : name and reason of those that have none."""

    rows: tuple[RuleRow, ...]
    left_out: tuple[tuple[str, str], ...]

    def to_dict(self) -> dict[str, object]:
        """Keys rules (a list) and left_out (rule and reason)."""
        left_out = [{"rule": rule, "reason": reason} for rule, reason in self.left_out]
        return {"rules": [row.to_dict() for row in self.rows], "left_out": left_out}


def compare_rules(
    model: ProcessModel, *, kind: str | None = None, form: str | None = None, **wishes: float | None
) -> Comparison:
    """All rules in all their kinds (or the one kind asked for).

    model : the process. form : form of all settings, default each rule's own. wishes : as tune() takes them; each rule
    is given those that it knows.

    Raises ValueError: the kind is not known, or no rule at all has an answer.
    """
    rows, left_out = [], []
    try:
        best = references(model.linear())
    except ValueError:
        best = None
    for rule in RULES.values():
        known = {OPTION_OF_WISH.get(name, name) for name in rule.wishes} | set(READINGS[rule.takes])
        given = {name: value for name, value in wishes.items() if name in known}
        try:
            kinds = [kind_for(rule, kind, model)] if kind else list(rule.kinds)
        except ValueError as error:
            left_out.append((rule.name, str(error)))
            continue
        for one in kinds:
            try:
                result = tune(model, rule.name, kind=one, form=form, **given)
            except ValueError as error:
                left_out.append((f"{rule.name} {one}", str(error)))
                continue
            if one == ControllerKind.PID and not result.tuning.gains.kd and ControllerKind.PI in rule.formulas:
                left_out.append((f"{rule.name} {one}", "no derivative action for this process, the same as PI"))
                continue
            found = performance(model.linear(), result.tuning.gains)
            j = weighted_cost(found, best.iae_setpoint, best.iae_load) if best else math.inf
            rows.append(RuleRow(result, found, j if math.isfinite(j) else None))
    if not rows:
        raise ValueError(f"no rule has an answer for this process: {'; '.join(reason for _, reason in left_out[:2])}")
    return Comparison(tuple(rows), tuple(left_out))
