"""How well single indexes tell causes apart, on drawn records: area under the ROC curve, 0.5 for none, 1 for perfect.

    python benchmarks/index_power.py [--seed 1] [--cases 160] [--traps 0]

Columns: stiction against external, stiction against all other causes, aggressive against ok and sluggish, sluggish
against ok and aggressive, noise against all others; with an arrow down where small values speak for the first. Only
records to which an index applies count. Also: how often a record without a loop at work is taken for one, and the
reverse (traps).
"""

import argparse
from collections import Counter, defaultdict

import numpy as np
from cases import diagnosis, traps
from cases.case import DiagnosisCase

from retuner.adaptive.indexes.condition import Condition
from retuner.adaptive.indexes.screening import Screening, screen
from retuner.adaptive.signals.sample import Window

CAUSES = set(diagnosis.CAUSES)
CONTRASTS = {
    "stiction/external": ({"stiction"}, {"external"}),
    "stiction/rest": ({"stiction"}, CAUSES - {"stiction"}),
    "aggressive": ({"aggressive"}, {"ok", "sluggish"}),
    "sluggish": ({"sluggish"}, {"ok", "aggressive"}),
    "noise/rest": ({"noise"}, CAUSES - {"noise"}),
}
FEWEST = 5
"""Records on either side that make an area."""


def screened(case: DiagnosisCase) -> Screening:
    """The indexes of a case."""
    record = case.record
    return screen(Window(record.t, record.sp, record.pv, record.co), case.gains, case.co_min, case.co_max)


def area(first: list[float], second: list[float]) -> float | None:
    """Chance that a value of the first is larger than one of the second (Mann & Whitney 1947)."""
    if min(len(first), len(second)) < FEWEST:
        return None
    a, b = np.array(first)[:, None], np.array(second)[None, :]
    return float(np.mean((a > b) + 0.5 * (a == b)))


def cell(value: float | None) -> str:
    """An area as 0.5 to 1 with its direction."""
    if value is None:
        return f"{'-':>18}"
    return f"{max(value, 1 - value):>17.2f}{'v' if value < 0.5 else ' '}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=160)
    parser.add_argument("--traps", type=int, default=0)
    options = parser.parse_args()
    values: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    conditions: dict[str, Counter[str]] = defaultdict(Counter)
    for maker, count in ((diagnosis.case, options.cases), (traps.case, options.traps)):
        for index in range(count):
            case = maker(options.seed, index)
            seen = screened(case)
            conditions[case.group][seen.condition.condition] += 1
            if maker is diagnosis.case:
                for name, value in seen.evidence.items():
                    values[name][case.group].append(value)
    print(f"seed {options.seed}, {options.cases} records\n{'':<18}" + "".join(f"{name:>18}" for name in CONTRASTS))
    table = {
        name: [
            area([x for g in a for x in groups[g]], [x for g in b for x in groups[g]]) for a, b in CONTRASTS.values()
        ]
        for name, groups in values.items()
    }
    for name, areas in sorted(table.items(), key=lambda item: -max(abs((x or 0.5) - 0.5) for x in item[1][:1])):
        print(f"{name:<18}" + "".join(cell(x) for x in areas))
    print("conditions by group")
    for group, counted in conditions.items():
        odd = {str(c): n for c, n in counted.items() if c != Condition.NORMAL}
        print(f"  {group:<24} {sum(counted.values()):>4} records, not normal: {odd or 'none'}")


if __name__ == "__main__":
    main()
