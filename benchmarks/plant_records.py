"""What does diagnose say of real loops? Counts by record and by tag, and a picture a record.

    python benchmarks/plant_records.py --data FOLDER [--pictures FOLDER] [--only TAG]

FOLDER holds index.csv (file, tag, sampling_time_s, samples, label) and the records (t, sp, pv, co). Labels are
"stiction" and "no stiction"; "no stiction" does not mean healthy. A tag's verdict is stiction when at least half of its
records are called so. The settings in force are not known: gains are left out where diagnose allows it.
"""

import argparse
import csv
import functools
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from cases.case import FloatArray, Record
from cases.counting import spread

from retuner import api


class Row(NamedTuple):
    """One record of the index with its verdict."""

    file: str
    tag: str
    label: str
    answer: str
    confidence: float
    retune: bool
    reason: str
    evidence: dict[str, float]
    seconds: float


def read(path: Path) -> Record:
    """A record of columns t, sp, pv, co."""
    with path.open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    columns = {key: np.array([float(row[key]) for row in rows]) for key in ("t", "sp", "pv", "co")}
    new = np.concatenate([[True], np.diff(columns["t"]) > 0])  # one of the records repeats some of its time stamps
    return Record(columns["t"][new], columns["sp"][new], columns["pv"][new], columns["co"][new])


def judge(data: Path, pictures: Path | None, entry: dict[str, str]) -> Row:
    """Diagnose one record."""
    record = read(data / entry["file"])
    begun = time.process_time()
    fits: dict[str, FloatArray] = {}
    try:
        result = api.diagnose(record.t, record.sp, record.pv, record.co, gains=None)
    except ValueError as error:
        row = Row(entry["file"], entry["tag"], entry["label"], "refused", 1.0, False, str(error), {}, 0.0)
    else:
        found, seconds = result.diagnosis, time.process_time() - begun
        fits = _fits(result, len(record.t))
        row = Row(
            entry["file"],
            entry["tag"],
            entry["label"],
            str(found.cause),
            found.confidence,
            found.retune,
            found.reason,
            dict(found.evidence),
            seconds,
        )
    if pictures is not None:
        _picture(record, fits, row, pictures / f"{Path(entry['file']).stem}.png")
    return row


def _fits(result: object, n: int) -> dict[str, FloatArray]:
    """Fitted pv of the hypotheses, where the result carries any."""
    found = getattr(result, "fits", None) or {}
    return {str(name): np.asarray(fit) for name, fit in found.items() if len(fit) == n}


def _picture(record: Record, fits: dict[str, FloatArray], row: Row, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    above.plot(record.t, record.pv, lw=0.8, label="pv")
    above.plot(record.t, record.sp, lw=0.8, label="sp")
    for name, fit in fits.items():
        above.plot(record.t, fit, lw=0.7, ls="--", label=name)
    below.plot(record.t, record.co, lw=0.8, color="C2", label="co")
    numbers = [f"{k} {v:.3g}" for k, v in row.evidence.items()]
    told = "\n".join("  ".join(numbers[i : i + 9]) for i in range(0, len(numbers), 9))
    above.set_title(
        f"{row.file} [{row.label}] called {row.answer} ({row.confidence:.2f})\n{row.reason}\n{told}",
        fontsize=7,
        loc="left",
    )
    for axes in (above, below):
        axes.tick_params(labelsize=7)
        axes.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def by_tag(rows: list[Row]) -> list[str]:
    """A line a tag: label, verdicts, right or not."""
    lines = []
    for tag in sorted({r.tag for r in rows}):
        own = [r for r in rows if r.tag == tag]
        called = sum(r.answer == "stiction" for r in own)
        said = "stiction" if 2 * called >= len(own) else "no stiction"
        mark = "right" if said == own[0].label else ("MISSED" if own[0].label == "stiction" else "FALSE ALARM")
        lines.append(f"{tag:<12}{own[0].label:<13}{mark:<12}" + ", ".join(r.answer for r in own))
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--only", metavar="TAG")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    if not hasattr(api, "diagnose"):
        sys.stderr.write("this retuner has no diagnose(t, sp, pv, co, gains=, co_min=, co_max=): nothing to measure\n")
        return 1
    if not (options.data / "index.csv").is_file():
        sys.stderr.write(f"{options.data / 'index.csv'} is not there; give the folder of the records with --data\n")
        return 2
    with (options.data / "index.csv").open(encoding="utf-8") as lines:
        entries = [e for e in csv.DictReader(lines) if options.only in {None, e["tag"]}]
    rows = list(spread(functools.partial(judge, options.data, options.pictures), entries, options.jobs))
    for label in ("stiction", "no stiction"):
        of_label = [r for r in rows if r.label == label]
        called = sum(r.answer == "stiction" for r in of_label)
        sys.stdout.write(f"{label}: {called} of {len(of_label)} records called stiction\n")
    sys.stdout.write(f"gain changes advised: {sum(r.retune for r in rows)} of {len(rows)}\n\n")
    sys.stdout.write("\n".join(by_tag(rows)) + "\n\n")
    for r in rows:
        sys.stdout.write(f"{r.file:<28}{r.label:<13}{r.answer:<17}{r.confidence:.2f} {r.seconds:5.2f}s  {r.reason}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
