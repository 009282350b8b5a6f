"""How a rule came to its settings: its formulas, the numbers put in, and where they come from."""

import re
from dataclasses import dataclass

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.registry import fitted_to, reading_for
from retuner.adaptive.rules.rule import ControllerKind, Oscillation, Rule, Takes, Tuning, Wishes
from retuner.adaptive.rules.simc import TAU_I_FACTOR, without_second_lag

PREFIXES = {
    "integrating: ": (ProcessType.INTEGRATING,),
    "integrating with lag: ": (ProcessType.INTEGRATING_LAG,),
    "pure delay: ": (ProcessType.DELAY,),
    "double integrating: ": (ProcessType.DOUBLE_INTEGRATING,),
}
"""Lines of a formula that are for some structures only."""
PRODUCT = re.compile(r"(?<=[\d)]) (?=[\d(])")
"""Between two numbers or brackets, where the formula leaves the sign of multiplication out."""
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
        return {
            "formula": list(self.formula),
            "with_numbers": list(self.with_numbers),
            "numbers": self.numbers,
            "source": self.source,
            "valid": self.valid,
        }


def explanation(
    rule: Rule,
    kind: ControllerKind,
    model: ProcessModel | None,
    reading: Oscillation | None,
    wishes: Wishes,
    found: Tuning,
) -> Explanation:
    """Of settings that this rule gave for these inputs."""
    lines, numbers = rule.formulas[kind], {}
    if rule.takes == Takes.MODEL:
        assert model is not None
        put_in = fitted_to(rule, model)[0]
        if kind == ControllerKind.PI and rule.name.startswith(("simc", "haugen")):
            put_in = without_second_lag(put_in)
        lines, numbers = _lines_for(lines, put_in.type), _symbols(put_in, found, wishes)
    else:
        swing, names = reading_for(rule, model, reading), ("Ku", "Pu")
        names = names if rule.takes == Takes.ULTIMATE else ("Kq", "Pq")
        numbers = dict(zip(names, (swing.gain, swing.period_s), strict=True))
    named = {name for line in lines for name in SYMBOL.findall(line.partition(" = ")[2])}
    used = {name: value for name, value in numbers.items() if name in named}
    return Explanation(lines, tuple(_filled(line, used) for line in lines), used, rule.source, rule.valid)


def _lines_for(lines: tuple[str, ...], structure: ProcessType) -> tuple[str, ...]:
    """The lines that apply to a structure; its own lines, where it has some, stand for all others."""
    own = tuple(
        line.removeprefix(prefix)
        for line in lines
        for prefix, structures in PREFIXES.items()
        if line.startswith(prefix) and structure in structures
    )
    return own or tuple(line for line in lines if not line.startswith(tuple(PREFIXES)))


def _symbols(model: ProcessModel, found: Tuning, wishes: Wishes) -> dict[str, float]:
    """Numbers under every name that the formulas use for them."""
    symbols = {"k": model.k, "K": model.k, "k'": model.slope, "k''": model.k, "M": model.slope}
    symbols |= {"theta": model.theta_s, "L": model.theta_s}
    if model.type in {ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.DELAY}:
        symbols |= {"tau1": model.tau1_s, "tau": model.tau1_s, "T": model.tau1_s}
    symbols |= {"tau2": model.tau2_s} if model.tau2_s else {}
    given = {
        "tau_c": found.tau_c_s,
        "lambda": found.tau_c_s,
        "u0": wishes.u0,
        "ymax": wishes.y_max,
        "m": wishes.ms,
        "c": wishes.c or TAU_I_FACTOR,
    }
    return symbols | {name: value for name, value in given.items() if value is not None}


def _filled(line: str, numbers: dict[str, float]) -> str:
    """The right hand side of a formula with its numbers."""
    name, equals, rest = line.partition(" = ")
    if not equals:
        return line
    filled = SYMBOL.sub(lambda m: f"{numbers[m[0]]:.6g}" if m[0] in numbers else m[0], rest)
    return f"{name} = {PRODUCT.sub(' * ', filled)}"
