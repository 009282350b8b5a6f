"""Do two engines, or two states of the code, judge the same? Their scores of the same drawn records, one by one.

    RETUNER_ENGINE=numpy python benchmarks/identification.py --seed 3 --cases 130 --no-bounds --out a.jsonl
    RETUNER_ENGINE=c     python benchmarks/identification.py --seed 3 --cases 130 --no-bounds --out b.jsonl
    python benchmarks/verdicts.py a.jsonl b.jsonl

Takes what identification.py and diagnosis.py write with --out. A verdict is the structure with identifiable and in spec
or not, or the cause with whether gains may change. Every difference is a line with the truth's word on both; status 1
when the second set is right less often than the first. CPU times are those of the calls, as a ratio of sums.
"""

import json
import sys
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def read(path: str) -> dict[tuple[str, int], Row]:
    rows = [json.loads(line) for line in Path(path).read_text(encoding="utf-8").splitlines()]
    return {(row["group"], row["index"]): row for row in rows}


def verdict(row: Row) -> tuple[Any, ...]:
    """What was said."""
    if "answer" in row:
        return row["answer"], row["retune"]
    return row["structure"], row["outcome"] not in {"not identifiable", "refused"}


def good(row: Row) -> bool:
    """Whether the truth agrees: the right cause and no wrong change, or settings in spec."""
    return row["right"] and not row["false_retune"] if "answer" in row else row["outcome"] == "in spec"


def described(row: Row) -> str:
    said = " ".join(str(word) for word in verdict(row))
    return f"{said} ({'right' if good(row) else row.get('outcome', 'wrong')})"


def main() -> int:
    if len(sys.argv) != 3:
        sys.stderr.write(__doc__ or "")
        return 2
    before, after = read(sys.argv[1]), read(sys.argv[2])
    if before.keys() != after.keys():
        sys.stderr.write("the two files hold other records\n")
        return 2
    lines = [
        f"{group} {index} {after[group, index]['family']}: {described(before[group, index])} -> "
        f"{described(after[group, index])}"
        for group, index in before
        if verdict(before[group, index]) != verdict(after[group, index])
    ]
    right = [sum(good(row) for row in rows.values()) for rows in (before, after)]
    took = [sum(row["seconds"] for row in rows.values()) for rows in (before, after)]
    sys.stdout.write("\n".join([
        *lines,
        f"{len(before)} records, {len(lines)} verdicts differ; right {right[0]} before, {right[1]} after",
        f"CPU of all calls {took[0]:.1f} s before, {took[1]:.1f} s after: {took[1] / took[0]:.3f}",
    ]) + "\n")  # fmt: skip
    return int(right[1] < right[0])


if __name__ == "__main__":
    sys.exit(main())
