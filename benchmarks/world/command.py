"""How good are the odds of `diagnose` in a world with real loads, and are they honest?

    python benchmarks/world --data FOLDER [--set step8] [--seed 1] [--cases 80] [--fold 0] [--jobs 2] [--out FILE]
    python benchmarks/world --data FOLDER --next ...      with the test made that each answer proposes
    python benchmarks/world --data FOLDER --real          what is said of the real records themselves
    python benchmarks/world --data FOLDER --invariance    and whether it stays under changes that mean nothing
    python benchmarks/world --data FOLDER --alike         whether its records can be told from real ones

FOLDER holds index.csv (file, tag, label) and records (t, sp, pv, co) of real loops; their co are the loads (draw.py).
--fold takes the loads of every second tag only, so that what was chosen on one half is counted on the other. Right: the
cause that is named is the true one; slow_integrating counts as aggressive (both have too little robustness), and what
is called external, noise, saturation or unknown is wrong. Log score: ln of the probability given to the true cause;
knowing nothing has ln(1/4) = -1.39. Settings are held to Ms on the true process. Seeds from 9000 are for final counts.
"""

import argparse
import csv
import functools
import json
import math
import statistics
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

from cases.case import share, spread

from retuner import PidGains, diagnosing
from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.signals.sample import Window
from world.alike import alike
from world.draw import BENDS, CLASSES, DT_S, SETS, drawn, tested
from world.invariance import invariance
from world.process import margins

AS = {"ok": "ok", "sluggish": "sluggish", "aggressive": "aggressive", "slow_integrating": "aggressive",
      "stiction": "stiction", "nonlinear": BENDS}  # fmt: skip
LEAST = 0.003  # Probability that a log score counts at least
BANDS = ((0.0, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 1.01))


@dataclass(frozen=True, slots=True)
class Score:
    """One case. said : the cause named. odds : of the four classes. ms_after : with the settings given, nan without.

    then, then_odds : the cause named, and the odds, once the test that was proposed was made as well. without : why no
    settings are given, where the cause that is named asks for some.
    """

    index: int
    true: str
    said: str
    odds: dict[str, float]
    ms_before: float
    ms_after: float
    next_size: float
    cpu_s: float
    then: str = ""
    then_odds: dict[str, float] = field(default_factory=dict)
    without: str = ""


def scored(seed: int, kind: str, folder: str, fold: int | None, test: bool, historian: bool, index: int) -> Score:
    """Draw a loop, diagnose its record with its gains told, judge the answer. test : make the test that it proposes."""
    case = drawn(seed, index, kind, folder, fold, historian=historian)
    interval_s = case.scene.interval_s
    gains = PidGains(case.kc, case.kc / (case.tau_i * interval_s))
    begun = time.process_time()
    result = diagnosing.diagnose(case.t, case.sp, case.pv, case.co, gains=gains)
    cpu_s = time.process_time() - begun
    told = result.diagnosis
    odds, size = shares(told), math.nan
    then, then_odds = "", {}
    if told.next is not None:
        size = told.next.size
        if test:
            hold = max(round(told.next.hold_s / DT_S), 1)
            record = tested(case, seed, str(told.next.kind), told.next.size, hold)
            windows = [Window(case.t, case.sp, case.pv, case.co), Window(*record)]
            result = diagnosing.diagnose_windows(windows, gains=gains)
            told_then = result.diagnosis
            then, then_odds = AS.get(str(told_then.cause), str(told_then.cause)), shares(told_then)
    after = math.nan
    if result.recommended is not None:
        new = result.recommended
        after = margins(case.process, new.kp, new.kp / new.ki / interval_s if new.ki else 1e9)[0]
    said = AS.get(str(told.cause), str(told.cause))
    without = result.diagnosis.reason.partition(". No settings: ")[2].partition(";")[0]
    return Score(index, case.cause, said, odds, case.ms, after, size, cpu_s, then, then_odds, without)


def shares(told: Diagnosis) -> dict[str, float]:
    """The odds of the four classes, and of a process that bends."""
    odds = dict.fromkeys((*CLASSES, BENDS), 0.0)
    for cause, p in (told.causes or {str(told.cause): told.confidence}).items():
        if cause in AS:
            odds[AS[cause]] += p
    return odds


def table(scores: list[Score]) -> list[str]:
    n = len(scores)
    right = sum(s.said == s.true for s in scores)
    lines = [f"right        {share(right, n)}", f"unknown      {share(sum(s.said == 'unknown' for s in scores), n)}"]
    lines.append(f"log score    {statistics.mean(math.log(max(s.odds[s.true], LEAST)) for s in scores):.2f}")
    for low, high in BANDS:
        told = [s for s in scores if low <= max(s.odds.values()) < high]
        hits = sum(max(s.odds, key=lambda c, odds=s.odds: odds[c]) == s.true for s in told)
        lines.append(f"told at {low:4.0%} to {min(high, 1):4.0%}   right {share(hits, len(told))}")
    due = [s for s in scores if s.true in {"sluggish", "aggressive"}]
    given = [s for s in due if not math.isnan(s.ms_after)]
    lines.append(f"settings given where due           {share(len(given), len(due))}")
    kept = Counter(s.without or f"named {s.said}" for s in due if math.isnan(s.ms_after))
    lines += [f"  {count:3} not: {why}" for why, count in kept.most_common()]
    false = [s for s in scores if s.true not in {"sluggish", "aggressive"} and not math.isnan(s.ms_after)]
    lines.append(f"change of gains where none is due  {share(len(false), n - len(due))}")
    if given:
        away = sum((s.ms_after < s.ms_before) == (s.true == "sluggish") for s in given)
        lines.append(f"of those where due, the wrong way  {share(away, len(given))}")
        over = sum(s.ms_after > 2.1 for s in given)
        lines.append(f"Ms after: largest {max(s.ms_after for s in given):.2f}, over 2.1 in {over} of {len(given)}")
    for true in {s.true: None for s in scores}:
        counts = Counter(s.said for s in scores if s.true == true)
        lines.append(f"{true:12} {', '.join(f'{said} {count}' for said, count in counts.most_common())}")
    proposed = [s for s in scores if s.then]
    if proposed:
        before, after = (sum(getattr(s, which) == s.true for s in proposed) for which in ("said", "then"))
        lines.append(f"where a test was proposed: right before   {share(before, len(proposed))}")
        lines.append(f"                           right after it {share(after, len(proposed))}")
        final = sum((s.then or s.said) == s.true for s in scores)
        lines.append(f"all, after the tests that were proposed   {share(final, n)}")
    cpu = sorted(s.cpu_s for s in scores)
    return [*lines, f"CPU s a record: median {statistics.median(cpu):.2f}, largest {cpu[-1]:.2f}"]


def real(folder: str) -> list[str]:
    """What is said of the real records, a line each, and the count of unknown."""
    lines, counts = [], Counter[str]()
    with (Path(folder) / "index.csv").open() as index:
        for row in csv.DictReader(index):
            result = diagnosing.diagnose(Path(folder) / row["file"])
            told = result.diagnosis
            counts[str(told.cause)] += 1
            odds = ", ".join(f"{cause} {p:.0%}" for cause, p in list(told.causes.items())[:3])
            given = "settings" if told.retune and result.settings is not None else "-"
            lines.append(f"{row['file']:28} {row['label']:12} {given:8} {odds}")
    return [*lines, ", ".join(f"{cause} {count}" for cause, count in counts.most_common())]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True)
    parser.add_argument("--set", choices=SETS, default="real", dest="kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=80)
    parser.add_argument("--fold", type=int, choices=(0, 1))
    parser.add_argument("--next", action="store_true", help="make the test that is proposed, and judge both records")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--invariance", action="store_true")
    parser.add_argument("--also", action="append", default=[], metavar="FILE", help="a record outside FOLDER")
    parser.add_argument("--alike", action="store_true")
    parser.add_argument("--historian", action="store_true", help="records as a historian keeps them")
    options = parser.parse_args()
    if options.real:
        print("\n".join(real(options.data)))
        return 0
    if options.alike:
        print("\n".join(alike(options.data, options.seed, options.cases, historian=options.historian)))
        return 0
    if options.invariance:
        print("\n".join(invariance(options.data, options.also, options.cases, options.jobs, options.out)))
        return 0
    work = functools.partial(
        scored, options.seed, options.kind, options.data, options.fold, options.next, options.historian
    )
    scores = []
    for score in spread(work, range(options.cases), options.jobs):
        scores.append(score)
        if options.out is not None:
            with options.out.open("a") as out:
                out.write(json.dumps({"seed": options.seed, "set": options.kind, **asdict(score)}) + "\n")
    print(f"set {options.kind}, seed {options.seed}, {options.cases} cases")
    print("\n".join(table(scores)))
    return 0
