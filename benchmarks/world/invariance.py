"""Is the cause of a record the same under nine changes that mean nothing?

    python benchmarks/world --data FOLDER --invariance [--cases 20]

Units of pv and sp, units of co, the sign of pv, the unit of time, every second row, a tenth cropped at the beginning or
at the end, half a sigma of noise, and four digits. Counted on the real records of FOLDER, gains read off each.
"""

import csv
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


def causes(path: str) -> list[str]:
    """The cause of a record as it is, and after each change."""
    record = window_of(path)
    changed = [record, *(change(record) for change in CHANGES.values())]
    return [str(diagnosing.diagnose_windows([one]).diagnosis.cause) for one in changed]


def invariance(folder: str, cases: int, jobs: int) -> list[str]:
    """A line for each record that is called otherwise after a change, and the counts."""
    with (Path(folder) / "index.csv").open() as index:
        files = [str(Path(folder) / row["file"]) for row in csv.DictReader(index)][:cases]
    lines, turned, alike = [], Counter[str](), 0
    for path, (as_it_is, *after) in zip(files, spread(causes, files, jobs), strict=True):
        other = {name: cause for name, cause in zip(CHANGES, after, strict=True) if cause != as_it_is}
        turned.update(other.keys())
        alike += not other
        if other:
            told = ", ".join(f"{name}: {cause}" for name, cause in other.items())
            lines.append(f"{Path(path).name:28} {as_it_is}; {told}")
    lines.append(f"all nine alike   {share(alike, len(files))}")
    return [*lines, *(f"  {name:26} turns {count}" for name, count in turned.most_common())]
