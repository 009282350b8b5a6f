"""Is the cause of a record the same under nine changes that mean nothing?

    python benchmarks/world --data FOLDER --invariance [--cases 20] [--also FILE] [--out FILE]

Units of pv and sp, units of co, the sign of pv, the unit of time, every second row, a tenth cropped at the beginning or
at the end, half a sigma of noise, and four digits. Counted on the real records of FOLDER, and on those named besides,
gains read off each. A name that turns between two causes of like odds is honest; one that turns by JUMPS is none.
"""

import csv
import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from cases.case import share, spread

from retuner import diagnosing
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.api import window_of


def _noisy(w: Window) -> Window:
    """With half a sigma of noise on pv."""
    return replace(w, pv=w.pv + 0.5 * noise_sigma(w.pv) * np.random.default_rng(1).standard_normal(len(w.pv)))


def _digits(x: FloatArray) -> FloatArray:
    """To four digits of its largest value."""
    largest = float(np.max(np.abs(x)))
    return np.round(x, 3 - math.floor(math.log10(largest))) if largest > 0 else x


CHANGES: dict[str, Callable[[Window], Window]] = {
    "units of pv": lambda w: replace(w, pv=1.8 * w.pv + 32.0, sp=1.8 * w.sp + 32.0),
    "units of co": lambda w: replace(w, co=0.16 * w.co + 4.0),
    "sign of pv": lambda w: replace(w, pv=-w.pv, sp=-w.sp),
    "unit of time": lambda w: replace(w, t_s=w.t_s / 60.0),
    "every second row": lambda w: w.part(slice(None, None, 2)),
    "the first tenth cropped": lambda w: w.part(slice(len(w.t_s) // 10, None)),
    "the last tenth cropped": lambda w: w.part(slice(None, len(w.t_s) - len(w.t_s) // 10)),
    "half a sigma of noise": _noisy,
    "four digits": lambda w: replace(w, pv=_digits(w.pv), sp=_digits(w.sp), co=_digits(w.co)),
}


Odds = dict[str, float]  # Causes with their probability, the one that is named first
SHOWN = 0.05  # A cause less probable than this is not printed
JUMPS = 0.4  # Change of the odds of a cause from which it is no near tie


def told(path: str) -> dict[str, Odds]:
    """What is said of a record as it is (under no name), and after each change."""
    record = window_of(path)
    changed = {"": record} | {name: change(record) for name, change in CHANGES.items()}
    said = {name: diagnosing.diagnose_windows([one]).diagnosis for name, one in changed.items()}
    return {name: {str(one.cause): one.confidence, **one.causes} for name, one in said.items()}


def invariance(folder: str, also: list[str], cases: int, jobs: int, out: Path | None) -> list[str]:
    """A line for each record that is called otherwise after a change, with the odds before and after, and the counts.

    also : records outside the folder. cases : how many of the folder. out : a line of JSON for each record.
    """
    with (Path(folder) / "index.csv").open() as index:
        files = [str(Path(folder) / row["file"]) for row in csv.DictReader(index)][:cases] + also
    lines, turned, jumped, alike = list[str](), Counter[str](), Counter[str](), list[tuple[str, bool]]()
    for path, said in zip(files, spread(told, files, jobs), strict=True):
        if out is not None:
            with out.open("a") as kept:
                kept.write(json.dumps({"file": Path(path).name, "odds": said}) + "\n")
        before = said.pop("")
        other = {name: after for name, after in said.items() if _named(after) != _named(before)}
        alike.append((_named(before), not other))
        turned.update(other.keys())
        lines += [f"{Path(path).name:28}{_likeliest(before)}"] * bool(other)
        for name, after in other.items():
            far = any(abs(before.get(c, 0.0) - after.get(c, 0.0)) >= JUMPS for c in (_named(before), _named(after)))
            jumped[name] += far
            lines.append(f"    {name:24}{'!' if far else ' '} {_likeliest(after)}")
    with_cause = [same for cause, same in alike if cause != "unknown"]
    lines.append(f"all nine alike         {share(sum(same for _, same in alike), len(alike))}")
    lines.append(f"of those with a cause  {share(sum(with_cause), len(with_cause))}")
    return lines + [f"  {name:24} turns {n}, {jumped[name]} by a jump (!)" for name, n in turned.most_common()]


def _named(odds: Odds) -> str:
    return next(iter(odds))


def _likeliest(odds: Odds) -> str:
    return ", ".join(f"{cause} {p:.0%}" for cause, p in list(odds.items())[:2] if p >= SHOWN)
