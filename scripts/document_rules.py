"""Write docs/rules.md from the registry of tuning rules, so that page and program cannot drift apart.

python scripts/document_rules.py
"""

from pathlib import Path

from retuner.adaptive.rules.registry import ALIASES, RULES
from retuner.adaptive.rules.rule import WISH_LABELS, Rule, Takes

PAGE = Path(__file__).resolve().parents[1] / "docs" / "rules.md"
HEAD = """# Tuning rules

```sh
retuner tune --type fopdt --k 2 --tau1 10 --theta 2 --rule amigo --kind pid --explain
retuner tune --type fopdt --k 2 --tau1 10 --theta 2 --all --plot all.png
```

Process types: `fopdt` k e^(-theta s)/(tau1 s + 1), `sopdt` with a second lag tau2, `integrating` k' e^(-theta s)/s,
`integrating-lag`, `double-integrating` k'' e^(-theta s)/s^2, `delay` k e^(-theta s). `sopdt-inverse` has a numerator
1 - b s, so pv answers the wrong way first; most rules count b as dead time. `sopdt-lead` has a b below 0: pv
jumps, then creeps. `topdt` has a third lag tau3, which most rules take by the half rule. Times are in seconds. A
reverse-acting process has a negative k and gets a negative Kc. In the formulas K = k, L = theta, tau = T = tau1, and
k' = k/tau1 for `fopdt`.

Each rule gives its settings in the form of its source; `--form series|ideal|parallel` converts them. Series:
Kc (1 + 1/(tau_I s))(tau_D s + 1). Ideal: Kc (1 + 1/(Ti s) + Td s). Series to ideal: f = 1 + tau_D/tau_I, Kc f, tau_I
f, tau_D/f; the reverse exists for Ti >= 4 Td.

A rule that has no place for a second lag gets the first order model of the half rule, and says so. A rule that has no
answer (wrong type, no dead time, no ultimate gain) says why in one line, status 2. Settings that would make the loop
unstable are shown as such, status 1. This page is written by scripts/document_rules.py.

| rule | form | works from | process types | options | range |
|---|---|---|---|---|---|
"""
NOTES = """
## Where sources differ

- **Ti of the reaction-curve PI rule** is L/0.3 = 3.33 L (Ziegler & Nichols; the PID appendix). A set of lecture slides
  prints 0.33 L: a slip, and unstable.
- **No overshoot**: the slides' table prints 0.3 Pu and 0.5 Pu, their worked example and most books 0.5 Pu and 0.33 Pu.
  Both are here: `zn-no-overshoot-printed` and `zn-no-overshoot`.
- **Haugen** has c = 1.44 in his appendix (`haugen`); Grimholt & Skogestad quote c = 2 from 2010 (`haugen-2010`).
- **IMC PI** is `imc` as in the table of 1986 and `imc-pi` with tau + theta/2 ("improved PI"), which Grimholt &
  Skogestad compare with.
- **ITAE** has one set of settings for load and one for setpoint changes; `itae` means the former.
- **Grimholt & Skogestad, table 2** prints J = 1.15 and 1.09 for tau1 = theta. Their own table 1 makes it 1.03 and
  0.97; that is what comes out here.

## Choosing tau_c

tau_c = theta (the default) is tight control: Ms 1.59 for first order, 1.70 for integrating. `--ms` and `--gm` find the
smallest tau_c that keeps a sensitivity peak or a gain margin. `simc-smooth --u0 U --ymax Y` is the slowest control
that holds the process value within Y against a disturbance U: Kc = |U|/|Y|. Without dead time tau_c has to be given.
Derivative action pays when tau2 > theta; the settings carry a note.

## The numbers

- **Margins** are exact, with the dead time in them.
- **IAE and TV** are those of unit steps of the setpoint and of the load at the process input. The derivative has no
  filter and acts on the error, so TV of a PID loop's setpoint step is infinite.
- **J** = 0.5 (IAE_setpoint/IAE_setpoint* + IAE_load/IAE_load*), the references being the PI controllers that are best
  for each at Ms = 1.59 (Grimholt & Skogestad 2012).
- **`--rule optimal --plot`** draws the best J against Ms, and SIMC with tau_c varied on it.

In Python, `adaptive/rules/slow_oscillation.py` is for a level loop that oscillates slowly (P0 > 3 tau_I): it needs Kc
tau_I larger by f = 0.1 (P0/tau_I0)^2.

## Formulas and sources
"""


def row(rule: Rule) -> str:
    """One line of the table."""
    kinds = ", ".join(kind.upper() for kind in rule.kinds)
    types = ", ".join(rule.types) if rule.takes == Takes.MODEL else "any with an ultimate gain"
    types = "-" if rule.takes == Takes.QUARTER_DECAY else types
    options = ", ".join(f"`--{WISH_LABELS.get(name, name).replace('_', '-')}`" for name in rule.wishes) or "-"
    takes = {Takes.MODEL: "model", Takes.ULTIMATE: "model, or `--ku --pu`", Takes.QUARTER_DECAY: "`--kq --pq`"}
    return f"| `{rule.name}` {kinds} | {rule.form} | {takes[rule.takes]} | {types} | {options} | {rule.valid} |"


def formulas(rule: Rule) -> str:
    """The section with a rule's formulas."""
    lines = [f"### {rule.name}", "", rule.source, ""]
    for kind, texts in rule.formulas.items():
        lines += [f"    {kind.upper() + ':':5}{text}" if i == 0 else f"         {text}" for i, text in enumerate(texts)]
    return "\n".join(lines)


def page() -> str:
    """The whole page."""
    table = "\n".join(row(rule) for rule in RULES.values())
    other = ", ".join(f"`{alias}` for `{name}`" for alias, name in ALIASES.items())
    sections = "\n\n".join(formulas(rule) for rule in RULES.values())
    return f"{HEAD}{table}\n\nOther names that work: {other}.\n{NOTES}\n{sections}\n"


if __name__ == "__main__":
    PAGE.write_text(page())
