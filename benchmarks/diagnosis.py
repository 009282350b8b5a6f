"""How often is the right cause found? Counts over records of the eight causes and over the traps, drawn from a seed.

    python benchmarks/diagnosis.py [--seed 1] [--cases 160] [--traps 190] [--jobs 1] [--only stiction]
                                   [--save-failures FOLDER] [--not-tuning] [--out FILE]

--out keeps every score as a line as soon as it is known, and draws no case again whose line is there: a long count is
made in pieces. --not-tuning leaves the three causes of tuning out, for the count of changes of gains that must not be.
Right: the answer is among those that the group allows (one cause for the eight; cases/traps.py says which for a trap).
False retune: a change of gains is advised where the cause is not tuning. Settings advised are held to the Ms limit,
max(1.8, 1.03 x the Ms of SIMC with perfect knowledge), on the true process. Records between two causes are not drawn
(cases/making.py, fits). Seeds from 1000 on are for final measurements, not for development.
"""

import argparse
import functools
import json
import math
import statistics
import sys
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from cases import diagnosis, traps
from cases.case import picture, share, spread
from cases.setting import DiagnosisCase

from retuner import PidGains, diagnosing

MS_LIMIT, MS_OVER_BEST = 1.8, 1.03
PRODUCT = (3.8, 4.2)  # k' Kc tau_I after the slow-oscillation rule


class Score(NamedTuple):
    """One case scored."""

    seed: int
    index: int
    group: str
    family: str
    hidden: str
    tuning: bool
    allowed: list[str]
    answer: str
    right: bool
    retune: bool
    false_retune: bool
    confidence: float
    ms_before: float
    ms_after: float
    ms_kept: bool
    product: float
    seconds: float
    samples: int
    reason: str
    evidence: dict[str, float]


def score(seed: int, folder: str | None, trap: bool, item: tuple[int, str | None]) -> Score:
    """Draw one case, diagnose it, judge the answer."""
    index, group = item
    case = traps.case(seed, index, group) if trap else diagnosis.case(seed, index, group)
    record, loop, begun = case.record, case.loop, time.process_time()
    confidence, retune, evidence, gains = 1.0, False, {}, None
    try:
        result = diagnosing.diagnose(*record, gains=case.gains, co_min=loop.low, co_max=loop.high)
    except ValueError as error:
        answer, reason = "refused", str(error)
    else:
        found = result.diagnosis
        answer, reason, retune = str(found.cause), found.reason, found.retune
        confidence, evidence = found.confidence, dict(found.evidence)
        gains = result.settings.tuning.gains if result.settings is not None else None
    seconds = time.process_time() - begun
    before, after, kept, product = _after(case, gains)
    right = answer in case.right
    wrong_change = retune and not case.retune_right
    if folder and (not right or wrong_change or not kept):
        # the record of a failure with what was said of it
        numbers = [f"{k} {v:.3g}" for k, v in evidence.items()]
        told = "\n".join("  ".join(numbers[i : i + 8]) for i in range(0, len(numbers), 8))
        true = "  ".join(f"{k} {v:.3g}" for k, v in case.note.items())
        title = (
            f"{case.group} / {loop.family}, case {case.index}: {case.hidden} called {answer}; Ms after {after:.2f}\n"
            f"{reason[:130]}\n{told}\ntrue: {true}"
        )
        picture(case.record, title, Path(folder) / f"{case.group.replace(' ', '_')}-{case.index}-{answer}.png")
    return Score(
        seed, index, case.group, loop.family, case.hidden, case.retune_right, sorted(case.right), answer, right, retune,
        wrong_change, confidence, before, after, kept, product, seconds, len(record.t), reason, evidence,
    )  # fmt: skip


def _after(case: DiagnosisCase, gains: PidGains | None) -> tuple[float, float, bool, float]:
    """Ms before and after on the true process, whether the limit is kept, and k' Kc tau_I of an integrating one."""
    loop, process = case.loop, case.loop.process
    before = loop.margins(case.gains).ms
    if gains is None:
        return before, math.nan, True, math.nan
    after = loop.margins(gains).ms
    product = process.k * gains.kp * gains.kp / gains.ki if process.integrators == 1 and gains.ki else math.nan
    return before, after, after <= max(MS_LIMIT, MS_OVER_BEST * loop.margins(loop.best).ms), product


def table(scores: list[Score]) -> list[str]:
    """Right, false retunes, settings over the limit and the answers, a line a group."""
    lines = [f"{'group':<24}{'right':<36}{'false retunes':>14}{'Ms over limit':>15}   answers"]
    for name in dict.fromkeys(s.group for s in scores):
        rows = [s for s in scores if s.group == name]
        said = ", ".join(f"{answer} {n}" for answer, n in Counter(s.answer for s in rows).most_common())
        changed = sum(not math.isnan(s.ms_after) for s in rows)
        over = f"{sum(not s.ms_kept for s in rows)} of {changed}"
        right = share(sum(s.right for s in rows), len(rows))
        lines.append(f"{name:<24}{right:<36}{sum(s.false_retune for s in rows):>14}{over:>15}   {said}")
    return lines


def confusion(scores: list[Score]) -> list[str]:
    """Truth down, answers across."""
    answers = [*diagnosis.CAUSES, "unknown", "refused"]
    lines = [f"{'':<18}" + "".join(f"{a[:10]:>11}" for a in answers)]
    for cause in diagnosis.CAUSES:
        counts = Counter(s.answer for s in scores if s.group == cause)
        lines.append(f"{cause:<18}" + "".join(f"{counts[a] or '.':>11}" for a in answers))
    return lines


def summary(scores: list[Score], name: str) -> list[str]:
    n, changed = len(scores), [s for s in scores if not math.isnan(s.ms_after)]
    products = [s.product for s in changed if s.answer == "slow_integrating" and s.product > 0]
    unknown = sum(s.answer in {"unknown", "refused"} and not s.right for s in scores)
    lines = [
        f"{name}: right       {share(sum(s.right for s in scores), n)}; of the rest {unknown} undecided",
        f"{name}: change of gains where the cause is not tuning "
        f"{share(sum(s.false_retune for s in scores), sum(not s.tuning for s in scores))}",
        f"{name}: settings within the Ms limit {share(sum(s.ms_kept for s in changed), len(changed))}; "
        f"worst Ms {max((s.ms_after for s in changed), default=math.nan):.2f}",
    ]
    if products:
        inside = sum(PRODUCT[0] <= p <= PRODUCT[1] for p in products)
        lines.append(
            f"{name}: k' Kc tau_I after slow_integrating within 3.8 to 4.2: {share(inside, len(products))}; "
            f"median {statistics.median(products):.2f}"
        )
    seconds = [1000 * s.seconds / s.samples for s in scores]
    lines.append(f"{name}: CPU s per 1000 samples: median {statistics.median(seconds):.2f}, largest {max(seconds):.2f}")
    return lines


def numbered(names: list[str], count: int, only: str | None, left_out: frozenset[str]) -> list[tuple[int, str | None]]:
    """Which cases to draw: the first `count`, or that many of one group, without those of groups left out."""
    if only is None:
        return [(i, None) for i in range(count) if names[i % len(names)] not in left_out]
    return [(names.index(only) + len(names) * i, only) for i in range(count)] if only in names else []


def known(path: Path | None, seed: int) -> list[Score]:
    """The scores that a file holds of a seed; a line that was cut off is drawn again."""
    if path is None or not path.is_file():
        return []
    whole = [line for line in path.read_text(encoding="utf-8").splitlines(keepends=True) if line.endswith("\n")]
    path.write_text("".join(whole), encoding="utf-8")
    return [s for s in (Score(**json.loads(line)) for line in whole) if s.seed == seed]


def scored(options: argparse.Namespace, trap: bool, items: list[tuple[int, str | None]]) -> list[Score]:
    """The scores of these cases in order, those that are known taken as they are."""
    found = {s.index: s for s in known(options.out, options.seed) if (s.group in traps.TRAPS) == trap}
    missing = [item for item in items if item[0] not in found]
    work = functools.partial(score, options.seed, options.save_failures, trap)
    for each in spread(work, missing, options.jobs):
        found[each.index] = each
        if options.out is not None:
            with options.out.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(each._asdict()) + "\n")
    return [found[index] for index, _ in items]


def told(scores: list[Score]) -> list[str]:
    """A line for each score that is not as it should be."""
    return [
        f"{s.group} {s.index} {s.family} [{s.hidden}]: {s.answer} ({s.confidence:.2f}) "
        f"{'FALSE RETUNE ' if s.false_retune else ''}Ms {s.ms_before:.2f} -> {s.ms_after:.2f}: {s.reason}"
        for s in scores
        if not s.right or s.false_retune or not s.ms_kept
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=160, help="of the eight causes, or of the one of --only")
    parser.add_argument("--traps", type=int, default=190, help="of all traps, or of the one of --only")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", choices=[*diagnosis.CAUSES, *traps.TRAPS])
    parser.add_argument("--not-tuning", action="store_true", help="without the three causes of tuning")
    parser.add_argument("--save-failures", metavar="FOLDER")
    parser.add_argument("--out", metavar="FILE", type=Path, help="every score as a line of JSON; goes on where it ends")
    options = parser.parse_args()
    left_out = frozenset({"aggressive", "sluggish", "slow_integrating"} if options.not_tuning else ())
    lines, everything = [f"seed {options.seed}"], []
    for name, names, count in (
        ("causes", list(diagnosis.CAUSES), options.cases),
        ("traps", list(traps.TRAPS), options.traps),
    ):
        items = numbered(names, count, options.only, left_out)
        if not items:
            continue
        scores = scored(options, name == "traps", items)
        lines += ["", *summary(scores, name), "", *table(scores)]
        if name == "causes":
            lines += ["", *confusion(scores)]
        everything += scores
    sys.stdout.write("\n".join([*lines, "", *told(everything)]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
