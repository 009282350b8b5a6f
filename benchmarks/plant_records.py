"""What do identify and diagnose say of real loops? A line a record, and counts by tag.

    python benchmarks/plant_records.py --data FOLDER [--also FILE] [--only TAG] [--out FILE]

FOLDER holds index.csv (file, tag, sampling_time_s, samples, label) and the records (t, sp, pv, co). Labels are
"stiction" and "no stiction"; "no stiction" does not mean healthy. --also names a record outside it, of a loop of its
own. The settings in force are not known: they are read off the record where it shows them.

Named: called stiction, or said not to move while co moves. Settings that are given are held to two models that do
not know of each other: identification's, and a plain first order with dead time fitted to pv after the setpoint steps
alone (the recorded co as input, no load, no filter). --out keeps every answer as a line of JSON, from which
real_record_page.py draws the pictures.
"""

import argparse
import csv
import json
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from cases.case import FloatArray, Record, spread
from scipy.optimize import least_squares
from scipy.signal import lfilter

from retuner import PidGains, ProcessModel, ProcessType, api, diagnosing
from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.signals.sample import Window

BoolArray = npt.NDArray[np.bool_]
STANDS = "does not move while co moves"
MS_MOST = 2.5
STEP_SHARE = 0.05  # A setpoint step of less than this share of pv's range shows nothing
TOLD = 0.05  # A cause less probable than this is not printed
START_LAGS, START_DELAYS = (0.5, 3.0, 20.0), (0.0, 1.0, 5.0)  # Starts of the plain fit, in samples


@dataclass(frozen=True, slots=True)
class Row:
    """One record with what is said of it. ms : of the settings given, on identification's model and the plain one."""

    file: str
    tag: str
    label: str
    identifiable: bool
    identified: str
    cause: str
    confidence: float
    retune: bool
    reason: str
    factor: float | None = None
    odds: dict[str, float] = field(default_factory=dict)
    ms: list[float] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def named(self) -> bool:
        """Whether the valve is named."""
        return self.cause == "stiction" or STANDS in self.reason

    @property
    def told(self) -> str:
        """The two likeliest causes, with the change of gain where one is recommended."""
        ranked = sorted(self.odds.items(), key=lambda pair: -pair[1])[:2] or [(self.cause, self.confidence)]
        change = f"; Kc x {self.factor:.2f}" if self.factor is not None and self.retune else ""
        return ", ".join(f"{cause} {odds:.0%}" for cause, odds in ranked if odds >= TOLD) + change


def read(path: Path) -> Record:
    """A record of columns t, sp, pv, co."""
    with path.open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    columns = {key: np.array([float(row[key]) for row in rows]) for key in ("t", "sp", "pv", "co")}
    new = np.concatenate([[True], np.diff(columns["t"]) > 0])  # one of the records repeats some of its time stamps
    return Record(columns["t"][new], columns["sp"][new], columns["pv"][new], columns["co"][new])


def judge(entry: dict[str, str]) -> Row:
    """What is said of one record."""
    record = read(Path(entry["path"]))
    window = Window(record.t, record.sp, record.pv, record.co)
    gains = settings_in_force(window).gains
    begun = time.process_time()
    try:
        found = api.identify(record.t, record.sp, record.pv, record.co, gains=gains)
        told = diagnosing.diagnose(record.t, record.sp, record.pv, record.co)
    except ValueError as error:
        return Row(entry["file"], entry["tag"], entry["label"], False, str(error), *_refused(record, error))
    given = [s.tuning.gains for s in (found.settings, told.settings) if s is not None]
    changed = told.settings.tuning.gains.kp / gains.kp if told.settings is not None and gains is not None else None
    said = told.diagnosis
    return Row(
        entry["file"],
        entry["tag"],
        entry["label"],
        found.estimate.identifiable,
        found.estimate.reason,
        str(said.cause),
        said.confidence,
        said.retune,
        said.reason,
        changed,
        dict(said.causes),
        [ms for g in given for ms in _held_to(g, found.estimate.log.model(), window)],
        time.process_time() - begun,
    )


def _refused(record: Record, error: ValueError) -> tuple[str, float, bool, str]:
    """Cause, confidence, retune and reason where identification has nothing to work on."""
    try:
        said = diagnosing.diagnose(record.t, record.sp, record.pv, record.co).diagnosis
    except ValueError:
        return "refused", 1.0, False, str(error)
    return str(said.cause), said.confidence, said.retune, said.reason


def _held_to(gains: PidGains, model: ProcessModel, window: Window) -> Iterator[float]:
    """Ms on both models, infinite where unstable; half a sampling interval counts as dead time."""
    for process in (model, plain_model(window)):
        if process is not None:
            delayed = ProcessModel(
                process.type, process.k, process.tau1_s, process.tau2_s, process.theta_s + window.sample_time_s / 2
            )
            yield min(sensitivity_peak(delayed.linear(), gains), 99.0)


def plain_model(window: Window) -> ProcessModel | None:
    """First order with dead time, fitted to pv after the setpoint steps alone; None where there are none."""
    steps = np.flatnonzero(np.abs(np.diff(window.sp)) > STEP_SHARE * np.ptp(window.pv)) + 1
    if not steps.size or steps.size > len(window.sp) / 10:
        return None
    n = len(window.sp)
    counted = np.zeros(n, dtype=bool)
    for at in steps:
        counted[max(at - 5, 0) : min(at + 40, n)] = True
    return _plain(window.pv, window.co, counted, window.sample_time_s)


def plain_step(t: FloatArray, pv: FloatArray, co: FloatArray) -> ProcessModel:
    """The same fitted to a whole record in manual."""
    found = _plain(pv, co, np.ones(len(t), dtype=bool), float(np.median(np.diff(t))))
    if found is None:
        raise ValueError("pv does not follow co")
    return found


def _plain(pv: FloatArray, co: FloatArray, counted: BoolArray, dt: float) -> ProcessModel | None:
    """First order with dead time by least squares over the samples that count."""

    def columns(p: FloatArray) -> FloatArray:
        # response of a unit gain; lag and delay in samples
        late = np.interp(np.arange(len(co)) - math.exp(p[1]) - 1, np.arange(len(co)), co)
        a = math.exp(-1 / math.exp(p[0]))
        moved = np.asarray(lfilter([1 - a], [1, -a], late - late[0]), dtype=np.float64)
        return np.column_stack([moved, np.ones(len(co))])[counted]

    def left(p: FloatArray) -> FloatArray:
        x = columns(p)
        return pv[counted] - x @ np.linalg.lstsq(x, pv[counted], rcond=None)[0]

    fits = [
        least_squares(left, np.log([lag, delay + 0.1]), bounds=([-3, -3], [7, 5]))
        for lag in START_LAGS
        for delay in START_DELAYS
    ]
    p = min(fits, key=lambda f: f.cost).x
    k = float(np.linalg.lstsq(columns(p), pv[counted], rcond=None)[0][0])
    return ProcessModel(ProcessType.FOPDT, k, math.exp(p[0]) * dt, 0.0, math.exp(p[1]) * dt) if k else None


def summary(rows: list[Row]) -> list[str]:
    """Counts, then a line a tag, then a line a record."""
    lines = []
    for label in sorted({r.label for r in rows}):
        own = [r for r in rows if r.label == label]
        lines.append(
            f"{label}: {sum(r.named for r in own)} of {len(own)} records named as a valve, "
            f"{sum(r.cause == 'stiction' for r in own)} of them called stiction, "
            f"gains changed in {sum(r.retune for r in own)}"
        )
    judged = [r for r in rows if r.ms]
    lines.append(
        f"settings given for {len(judged)} records; Ms over {MS_MOST:g} on one of the models: "
        + (", ".join(f"{r.file} ({max(r.ms):.2f})" for r in judged if max(r.ms) > MS_MOST) or "none")
    )
    lines.append("")
    for tag in sorted({r.tag for r in rows}):
        own = [r for r in rows if r.tag == tag]
        causes = [r.cause for r in own]
        lines.append(
            f"{tag:<12}{own[0].label:<13}named {sum(r.named for r in own)} of {len(own)}  "
            + ", ".join(f"{cause} {causes.count(cause)}" for cause in dict.fromkeys(causes))
        )
    lines.append("")
    for r in rows:
        settings = "  Ms " + ", ".join(f"{ms:.2f}" for ms in r.ms) if r.ms else ""
        lines.append(f"{r.file:<26}{r.told:<34}{r.seconds:5.1f}s  {r.reason}{settings}")
        lines.append(f"{'':<26}identify: {'yes' if r.identifiable else 'no'}, {r.identified}")
    return lines


def entries_of(data: Path, also: list[Path], only: str | None) -> list[dict[str, str]]:
    """The records to look at."""
    with (data / "index.csv").open(encoding="utf-8") as lines:
        found = [{**e, "path": str(data / e["file"])} for e in csv.DictReader(lines)]
    found += [{"file": p.name, "tag": p.stem, "label": "no stiction", "path": str(p)} for p in also]
    return [e for e in found if only in {None, e["tag"]}]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, type=Path)
    parser.add_argument("--also", type=Path, action="append", default=[], metavar="FILE")
    parser.add_argument("--only", metavar="TAG")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    if not (options.data / "index.csv").is_file():
        sys.stderr.write(f"{options.data / 'index.csv'} is not there; give the folder of the records with --data\n")
        return 2
    entries = entries_of(options.data, options.also, options.only)
    rows = list(spread(judge, entries, options.jobs))
    if options.out is not None:
        options.out.write_text("".join(json.dumps(asdict(r)) + "\n" for r in rows), encoding="utf-8")
    sys.stdout.write("\n".join(summary(rows)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
