"""Tables of rows: places in spec with Wilson's interval, IAE over the perfect table's, how many sets, a line a kind."""

import math
import statistics
from collections.abc import Callable, Iterable
from typing import Any

from cases.case import share

from schedules.subject import NAMES

Row = dict[str, Any]
WHO = ("before", "fixed", "four", "points", "designed", "perfect")
WITHIN_ONE = 1
OUT = 2.0  # Standard deviations within which 95 % should lie


def line(row: Row) -> str:
    who = row["who"]
    parts = [
        f"{name} {of['spec']}/{of['places']} Ms {of['ms']:.2f} IAE {of['iae']:.2f} ({of['sets']})"
        for name, of in who.items()
        if name != "perfect"
    ]
    fewest = f" fewest {row['fewest'][0]} steps {row['fewest'][1]} lines;" if "fewest" in row else ""
    told = "" if "designed" in who else f" NO TABLE: {row['reason']}"
    cost = f"{row['samples']} samples, {row['seconds']} s"
    return f"{row['name']}, {row['mode']}:{fewest} {'; '.join(parts)}; {cost}{told}"


def table(rows: list[Row]) -> list[str]:
    rows = [row for row in rows if not row["record_lost"]]
    lines: list[str] = []
    for kind, some in _by(rows, lambda row: f"{row['kind']}, {row['mode']}").items():
        lines += [f"{kind}: {len(some)} cases", *_who(some)]
    lines += ["all", *_who(rows), *_sizes(rows)]
    return lines


def _by(rows: Iterable[Row], of: Callable[[Row], str]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(of(row), []).append(row)
    return found


def _who(rows: list[Row]) -> list[str]:
    lines = []
    for name in WHO:
        some = [row["who"][name] for row in rows if name in row["who"]]
        if not some:
            continue
        iae = sorted(of["iae"] for of in some)
        spec, places = (sum(of[key] for of in some) for key in ("spec", "places"))
        fast, unstable = (sum(of[key] for of in some) for key in ("fast", "unstable"))
        lost = sum(math.isinf(x) for x in iae)
        lines.append(
            f"  {name:<10}{share(spec, places)}   Ms too large {fast:4d}, unstable {unstable:3d}, walks lost {lost:2d}"
            f"   IAE median {statistics.median(iae):.2f}, worst {iae[-1]:.2f}"
            f"   sets {statistics.fmean(of['sets'] for of in some):.1f}"
        )
    return lines


def _sizes(rows: list[Row]) -> list[str]:
    designed = [row for row in rows if "designed" in row["who"]]
    lines = [f"with a schedule            {share(len(designed), len(rows))}"]
    constant = [row for row in rows if row["constant"]]
    if constant:
        one = sum(row["size"] == 1 for row in constant)
        lines.append(f"constant: one region       {share(one, len(constant))}")
    varying = [row for row in designed if not row["constant"] and row.get("fewest", (0, 0))[0]]
    if varying:
        within = sum(row["size"] <= min(row["fewest"]) + WITHIN_ONE for row in varying)
        lines.append(f"sets within one of fewest  {share(within, len(varying))}")
    for name in NAMES:
        off = [abs(of["off"][name]) / of["std"][name] for row in rows for of in row.get("bands", ())]
        if off:
            lines.append(f"truth of {name:<6}within 2 sd {share(sum(x <= OUT for x in off), len(off))}")
    good = sum(row["who"]["designed"]["spec"] >= 0.9 * row["who"]["designed"]["places"] for row in designed)
    lines.append(f"cases with 90 % in spec    {share(good, len(designed))}" if designed else "")
    return lines
