"""All tuning rules by name, and the one door through which they are asked."""

import math
import re

from retuner.adaptive.loop.margins import ultimate
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules import averaging, classic, lambda_imc, optimal, simc_family, ziegler_nichols
from retuner.adaptive.rules.rule import WISH_LABELS, ControllerKind, Oscillation, Rule, Takes, Tuning, Wishes
from retuner.adaptive.rules.simc import TAU_I_FACTOR, without_second_lag
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values

MODULES = (simc_family, averaging, optimal, lambda_imc, classic, ziegler_nichols)
RULES: dict[str, Rule] = {rule.name: rule for module in MODULES for rule in module.RULES}  # Every rule by its name
ALIASES = {"itae": "itae-load", "zn-quarter-decay": "quarter-decay"}  # other names that people try


def rule_named(name: str) -> Rule:
    """The rule of that name. Raises ValueError: there is none; the message has the list."""
    found = RULES.get(ALIASES.get(name, name))
    if found is None:
        raise ValueError(f"rule {name!r} is not known; give one of {', '.join(RULES)}")
    return found


def kind_for(rule: Rule, name: str | None, model: ProcessModel | None) -> ControllerKind:
    """The kind of that name, or the rule's usual one.

    Raises ValueError: it is not a kind, or the rule has no such settings.
    """
    if name is None:
        two = model is not None and model.type == ProcessType.DOUBLE_INTEGRATING
        return ControllerKind.PID if two and ControllerKind.PID in rule.formulas else rule.usual_kind
    if name not in set(ControllerKind):
        raise ValueError(f"kind {name!r} is not known; give one of {', '.join(ControllerKind)}")
    kind = ControllerKind(name)
    if kind not in rule.formulas:
        raise ValueError(f"rule {rule.name} has no {name.upper()} settings; give --kind {' or '.join(rule.kinds)}")
    return kind


def settings(
    rule: Rule,
    kind: ControllerKind,
    model: ProcessModel | None,
    reading: Oscillation | None = None,
    wishes: Wishes | None = None,
) -> Tuning:
    """Settings by a rule.

    rule : from RULES. kind : one that the rule has.
    model : the process; not needed where a reading is given to a rule that takes one.
    reading : Ku and Pu, or Kq and Pq, as the rule takes; Ku and Pu are worked out from the model where missing.
    wishes : what is asked of the rule.

    Raises ValueError: the rule needs something else, has no use for a wish, or has no answer for this process (named).
    """
    asked = wishes or Wishes()
    for name in asked.given():
        value = getattr(asked, name)
        label = WISH_LABELS.get(name, name)
        if name not in rule.wishes:
            raise ValueError(f"rule {rule.name} has no use for {label}; leave it out")
        if not math.isfinite(value):
            raise ValueError(f"{label} = {value} is not a finite number")
    try:
        # The rule's answer, with a note when a model had to be simplified for it
        if rule.from_oscillation is not None:
            return rule.from_oscillation(reading_for(rule, model, reading), kind)
        assert rule.from_model is not None
        if reading is not None:
            raise ValueError(f"rule {rule.name} works from a model, not from a gain and a period; leave these out")
        if model is None:
            raise ValueError(f"rule {rule.name} works from a model; give its type, k, tau1, tau2, theta")
        fitted, notes = fitted_to(rule, model)
        found = rule.from_model(fitted, kind, asked)
        if model.zeta < 1:
            notes = (*notes, f"this process swings (zeta = {model.zeta:g}) and rules know real lags only: look at Ms")
        return replace(found, notes=(*found.notes, *notes))
    except (OverflowError, ZeroDivisionError):
        raise ValueError(
            f"rule {rule.name}: these numbers are beyond what can be computed; check their units"
        ) from None


def reading_for(rule: Rule, model: ProcessModel | None, reading: Oscillation | None) -> Oscillation:
    """The gain and period that a rule works from."""
    if reading is not None:
        return reading
    if rule.takes == Takes.QUARTER_DECAY:
        raise ValueError(f"rule {rule.name} works from kq and pq, gain and period read at quarter decay; give both")
    if model is None:
        raise ValueError(f"rule {rule.name} works from ku and pu; give both, or a model they follow from")
    gain, period_s = ultimate(model.linear())
    return Oscillation(gain, period_s)


def fitted_to(rule: Rule, model: ProcessModel) -> tuple[ProcessModel, tuple[str, ...]]:
    """The model as the rule takes it: its second lag taken up by the half rule where the rule has no place for it."""
    if model.type in rule.types:
        return model, ()
    if model.inverse_s > 0 and ProcessType.SOPDT in rule.types:
        return model.without_inverse(), (f"the inverse response of {model.inverse_s:g} s counts as dead time",)
    if model.tau3_s and ProcessType.SOPDT in rule.types:
        return model.of_second_order(), (f"of the third lag of {model.lags_s()[-1]:g} s half counts as dead time",)
    reduced = without_second_lag(model)
    if reduced.type not in rule.types:
        wanted = ", ".join(rule.types)
        raise ValueError(f"rule {rule.name} has no settings for type {model.type}; it takes {wanted}")
    word = "same gain and phase" if model.inverse_s < 0 else "half rule"
    numbers = " ".join(f"{k} = {v:g}" for k, v in reduced.to_dict().items() if isinstance(v, float) and v)
    return reduced, (f"made from the first order model of the {word}: {numbers}",)


# ---- How a rule came to its settings: its formulas, the numbers put in, and where they come from

PREFIXES = {
    "integrating: ": ProcessType.INTEGRATING,
    "integrating with lag: ": ProcessType.INTEGRATING_LAG,
    "pure delay: ": ProcessType.DELAY,
    "double integrating: ": ProcessType.DOUBLE_INTEGRATING,
}
"""Lines of a formula that are for some structures only."""
PRODUCT = re.compile(r"(?<=[\d)]) (?=[\d(])")
"""Place between two numbers or brackets where the formula leaves the sign of multiplication out."""
SYMBOL = re.compile(r"k''|k'|[A-Za-z]\w*")


@dataclass(frozen=True, slots=True)
class Explanation:
    """Formula lines, the same with numbers, the numbers by symbol, source and range of a rule."""

    formula: tuple[str, ...]
    with_numbers: tuple[str, ...]
    numbers: dict[str, float]
    source: str
    valid: str

    def to_dict(self) -> dict[str, object]:
        """Keys formula, with_numbers, numbers, source, valid."""
        return plain_values(self, "formula with_numbers numbers source valid")


def explanation(
    rule: Rule,
    kind: ControllerKind,
    model: ProcessModel | None,
    reading: Oscillation | None,
    wishes: Wishes,
    found: Tuning,
) -> Explanation:
    """The explanation of settings that this rule gave for these inputs."""
    lines, numbers = rule.formulas[kind], {}
    if rule.takes == Takes.MODEL:
        assert model is not None
        put_in = fitted_to(rule, model)[0]
        if kind == ControllerKind.PI and rule.name.startswith(("simc", "haugen")):
            put_in = without_second_lag(put_in)
        # the lines that apply to this structure; its own lines, where it has some, stand for all others
        own = tuple(
            line.removeprefix(prefix)
            for line in lines
            for prefix, structure in PREFIXES.items()
            if line.startswith(prefix) and structure == put_in.type
        )
        lines = own or tuple(line for line in lines if not line.startswith(tuple(PREFIXES)))
        numbers = _symbols(put_in, found, wishes)
    else:
        swing, names = reading_for(rule, model, reading), ("Ku", "Pu")
        names = names if rule.takes == Takes.ULTIMATE else ("Kq", "Pq")
        numbers = dict(zip(names, (swing.gain, swing.period_s), strict=True))
    named = {name for line in lines for name in SYMBOL.findall(line.partition(" = ")[2])}
    used = {name: value for name, value in numbers.items() if name in named}
    return Explanation(lines, tuple(_filled(line, used) for line in lines), used, rule.source, rule.valid)


def _symbols(model: ProcessModel, found: Tuning, wishes: Wishes) -> dict[str, float]:
    """Numbers under every name that the formulas use for them."""
    symbols = {"k": model.k, "K": model.k, "k'": model.slope, "k''": model.k, "M": model.slope}
    symbols |= {"theta": model.theta_s, "L": model.theta_s}
    if model.type in {ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.DELAY}:
        symbols |= {"tau1": model.tau1_s, "tau": model.tau1_s, "T": model.tau1_s}
    symbols |= {"tau2": model.tau2_s} if model.tau2_s else {}
    given = {"tau_c": found.tau_c_s, "lambda": found.tau_c_s, "u0": wishes.u0, "ymax": wishes.y_max}
    given |= {"m": wishes.ms, "c": wishes.c or TAU_I_FACTOR}
    return symbols | {name: value for name, value in given.items() if value is not None}


def _filled(line: str, numbers: dict[str, float]) -> str:
    """The right hand side of a formula with its numbers."""
    name, equals, rest = line.partition(" = ")
    if not equals:
        return line
    filled = SYMBOL.sub(lambda m: f"{numbers[m[0]]:.6g}" if m[0] in numbers else m[0], rest)
    return f"{name} = {PRODUCT.sub(' * ', filled)}"
