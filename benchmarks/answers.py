"""What the code answers, to the last digit: stored once, compared later. For changes that shall change no answer.

    python benchmarks/answers.py store FILE [--jobs 2] [--part demo ...] [--every N]
    python benchmarks/answers.py compare FILE [--jobs 2] [--part demo ...] [--every N] [--with OTHER]

Parts: the demo under two seeds (every row of its ledger, gains, scores, the bus log's hash), runs of the on-line batch
(gains after each disturbance, every decision), rows of its other parts (bad changes injected, processes that change, do
no harm), identification and diagnosis of drawn records, half of the latter traps.
`compare` works everything out again, or reads OTHER, and tells each difference once per key path: how often, by how
much, first examples (path: before -> after). Status 1 when anything differs. `input` is a hash of the record: where it
differs, another question was asked.
Answers are the same to the last digit only with the same libraries on the same kind of processor; FILE tells which.
FILE ending in .gz is compressed.
"""

import argparse
import gzip
import hashlib
import json
import math
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from cases import diagnosis, identification, traps
from cases.case import Record
from cases.plant import HeldPlant
from online import batch, changes, harm, injected
from online.judge import Judge, Judgement
from online.loop import WatchedLoop, Watching, one_region, settings
from online.runner import Task
from online.session import PV_SPAN

from retuner import PidGains, diagnose, identify

ROOT = Path(__file__).resolve().parents[1]
DEMO = "examples/oven.toml"
DEMO_SEEDS = (1, 101)
SEED = 12  # Seed of every record drawn here, and of the batch's starts
RECORDS = 60
BATCH = {"opened": (9, 0), "defaults": (9, 4)}
"""Every which run of the batch, from which on: with limits of a change at x8, and with the default ones."""
ROWS = {"injected": (injected, 2), "changes": (changes, 1), "harm": (harm, 1)}
"""Other parts of benchmarks/online, and how many runs of each kind."""
UNSAID = frozenset({"session", "end"})
"""Rows of a ledger that name versions, files and the configuration; what they say of the bus log is kept apart."""
EXAMPLES = 3
SHOWN = 100  # Characters of a value in an example

Answer = dict[str, Any]


# ---- what is asked


def demo(seed: str) -> Answer:
    """The oven under a seed: rows of the ledger by kind, gains and scores at the end, hash of the traffic."""
    text = (ROOT / DEMO).read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as place:
        config, folder, rows = Path(place, "oven.toml"), Path(place, "run"), Path(place, "rows.jsonl")
        config.write_text(text.replace("\nseed = 1\n", f"\nseed = {seed}\n"), encoding="utf-8")
        said = json.loads(_retuner("run", str(config), "--out", str(folder), "--json"))
        _retuner("ledger", "export", str(folder), "--jsonl", str(rows))
        kinds: dict[str, list[Any]] = defaultdict(list)
        traffic, digests = "", list[str]()
        for row in map(json.loads, rows.read_text(encoding="utf-8").splitlines()):
            traffic = row["body"].get("bus_log_sha256", traffic)
            if row["kind"] not in UNSAID:
                kinds[row["kind"]].append({"clock_s": row["clock_s"], **_without_digests(row["body"], digests)})
    told = {key: said[key] for key in ("gains", "scores", "advice", "revision")}
    return {"input": _hash(text.encode()), "rows": kinds, **told, "traffic": traffic}


def _retuner(*arguments: str) -> str:
    """What a command prints.

    Raises RuntimeError: it failed; with what it said.
    """
    done = subprocess.run(
        [sys.executable, "-P", "-m", "retuner", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"retuner {' '.join(arguments)}: status {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def _without_digests(body: Answer, known: list[str]) -> Answer:
    """Digests numbered as they come: a key renamed in one body would change them in all rows that refer to it."""
    told = {}
    for key, value in body.items():
        digest = isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value)
        if digest and value not in known:
            known.append(value)
        told[key] = f"digest {known.index(value) + 1}" if digest else value
    return told


class NotingJudge(Judge):
    """Notes what it is asked to judge: the gains in force after each disturbance."""

    def __init__(self, task: batch.Task) -> None:
        process = task.member.process
        super().__init__(process, Judge.theta(process) / batch.SAMPLES_PER_THETA)
        self.noted: list[PidGains] = []

    def of(self, gains: PidGains) -> Judgement:
        """The same, noted."""
        self.noted.append(gains)
        return super().of(gains)


def online(name: str) -> Answer:
    """One run of the batch, as benchmarks/online makes it."""
    task = _batch()[name]
    judge = NotingJudge(task)
    kc, tau_i = task.start
    first = PidGains(judge.best.kp * kc, judge.best.ki * kc / tau_i)
    watching = Watching(one_region(first), settings(judge.dt_s, PV_SPAN, opened=task.opened))
    loop = WatchedLoop(HeldPlant(task.member.process, judge.dt_s), watching.retuner.table, judge.dt_s, watching)
    judged = batch.disturbed(loop, judge, task, [])
    after = [
        {**_gains(gains), "ms": found.ms, "j": found.j}
        for gains, found in zip(judge.noted, judged, strict=False)  # a lost loop is not judged any more
    ]
    return {
        "input": _hash(repr((task.member.process, first, judge.dt_s, task.seed)).encode()),
        "after": after,
        "decisions": [decision.to_dict() for decision in watching.decisions],
    }


def _batch() -> dict[str, batch.Task]:
    found = {}
    for limits, (every, offset) in BATCH.items():
        for task in batch.tasks(SEED, opened=limits == "opened", every=every, offset=offset):
            found[f"{task.member.name}, kc x{task.start[0]:g}, tau_i x{task.start[1]:g}, {limits}"] = task
    return found


def other(name: str) -> Answer:
    """The row of a run of another part of benchmarks/online."""
    part, kind, index = name.split(", ")
    row: Answer = ROWS[part][0].run(Task(kind, SEED, int(index)))
    return row


def _others() -> list[str]:
    return [f"{part}, {kind}, {i}" for part, (of, count) in ROWS.items() for kind in of.KINDS for i in range(count)]


def identified(index: str) -> Answer:
    """What identify says of a drawn record."""
    case = identification.case(SEED, int(index))
    record = case.record
    asked = {"input": _input(record), "group": case.group, "family": case.loop.family}
    try:
        found = identify(
            *record, open_loop=case.gains is None, gains=case.gains, co_min=case.loop.low, co_max=case.loop.high
        )
    except ValueError as error:
        return {**asked, "refused": str(error)}
    return {**asked, **found.to_dict()}


def diagnosed(name: str) -> Answer:
    """What diagnose says of a drawn record of the eight causes, or of a trap."""
    kind, index = name.split()
    case = (diagnosis if kind == "cause" else traps).case(SEED, int(index))
    record = case.record
    asked = {"input": _input(record), "group": case.group, "family": case.loop.family}
    try:
        found = diagnose(*record, gains=case.gains, co_min=case.loop.low, co_max=case.loop.high)
    except ValueError as error:
        return {**asked, "refused": str(error)}
    return {**asked, **found.to_dict(), "estimate": found.estimate.to_dict() if found.estimate else None}


def _gains(gains: PidGains) -> dict[str, float]:
    return {"kp": gains.kp, "ki": gains.ki, "kd": gains.kd}


def _input(record: Record) -> str:
    return _hash(b"".join(values.tobytes() for values in record))


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


ASKED: dict[str, tuple[Callable[[str], Answer], Callable[[], Iterable[str]]]] = {
    "demo": (demo, lambda: map(str, DEMO_SEEDS)),
    "online": (online, _batch),
    "rows": (other, _others),
    "identification": (identified, lambda: map(str, range(RECORDS))),
    "diagnosis": (diagnosed, lambda: [f"{kind} {i}" for kind in ("cause", "trap") for i in range(RECORDS // 2)]),
}
"""What answers a question of each part, and the questions' names."""


# ---- asking and keeping


def questions(parts: Iterable[str], every: int) -> list[tuple[str, str]]:
    """Part and name of every question that is asked, the longest parts first."""
    return [(part, name) for part in ASKED if part in parts for name in list(ASKED[part][1]())[::every]]


def answered(question: tuple[str, str]) -> tuple[Answer, float]:
    """The answer in plain values, and the CPU seconds it took, those of commands among them."""
    part, name = question
    begun = os.times()
    answer = ASKED[part][0](name)
    ended = os.times()
    seconds = sum(ended[:4]) - sum(begun[:4])
    return plain(answer), seconds


def plain(value: Any) -> Any:  # noqa: ANN401  whatever an answer may hold
    """What JSON gives back; numbers that it lacks are named."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    return json.loads(json.dumps(value))


def all_answers(asked: list[tuple[str, str]], jobs: int) -> tuple[dict[str, dict[str, Answer]], dict[str, float]]:
    """The answers by part and name, and each part's CPU seconds; always in processes that begin with one thread."""
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    answers: dict[str, dict[str, Answer]] = defaultdict(dict)
    seconds: dict[str, float] = defaultdict(float)
    with get_context("spawn").Pool(jobs, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        for done, ((part, name), (answer, took)) in enumerate(zip(asked, pool.imap(answered, asked), strict=True), 1):
            answers[part][name] = answer
            seconds[part] += took
            sys.stderr.write(f"{done} of {len(asked)}: {part} {name}, {took:.1f} s of CPU\n")
    return answers, seconds


def libraries() -> dict[str, str]:
    """What the last digits depend on beside the code."""
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in ("numpy", "scipy", "filterpy")},
    }


def read(path: Path) -> Answer:
    with gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else path.open(encoding="utf-8") as file:
        found: Answer = json.load(file)
    return found


def write(path: Path, document: Answer) -> None:
    with gzip.open(path, "wt", encoding="utf-8") if path.suffix == ".gz" else path.open("w", encoding="utf-8") as file:
        json.dump(document, file, allow_nan=False, sort_keys=True)


# ---- comparing


def leaves(value: Any, place: str) -> Iterator[tuple[str, str]]:  # noqa: ANN401  whatever JSON holds
    """Every value that holds no others, by its path."""
    if isinstance(value, dict | list) and value:
        pairs = value.items() if isinstance(value, dict) else ((f"[{i}]", inner) for i, inner in enumerate(value))
        for key, inner in pairs:
            yield from leaves(inner, f"{place}{key}" if isinstance(value, list) else f"{place}.{key}")
    else:
        yield place, json.dumps(value)  # 1 and 1.0, 0.0 and -0.0 are not the same answer


def differences(before: Answer, after: Answer) -> list[str]:
    """What differs between two sets of answers: a line a key path with examples; records are met by their names."""
    found: dict[str, list[tuple[str, str, str]]] = defaultdict(list)
    for part in sorted(before.keys() | after.keys()):
        one, other = before.get(part, {}), after.get(part, {})
        for name in sorted(one.keys() | other.keys()):
            old, new = (dict(leaves(of.get(name, {}), "")) for of in (one, other))
            for place in sorted(old.keys() | new.keys()):
                was, now = old.get(place, "nothing"), new.get(place, "nothing")
                if was != now:
                    found[part + re.sub(r"\[\d+\]", "[*]", place)].append((f"{part} {name}{place}", was, now))
    lines = []
    for group, of in sorted(found.items()):
        lines.append(f"{group}: differs{_by_how_much(of)}, {len(of)} times")
        lines += [f"    {place}: {was[:SHOWN]} -> {now[:SHOWN]}" for place, was, now in of[:EXAMPLES]]
    return lines


def _by_how_much(found: list[tuple[str, str, str]]) -> str:
    """The largest relative difference, where all are numbers."""
    try:
        numbers = [(float(a), float(b)) for _, a, b in found]
    except ValueError:
        return ""
    return f" by up to {max(abs(b - a) / (max(abs(a), abs(b)) or 1.0) for a, b in numbers):.2g} of it"


# ---- the command


def _store(options: argparse.Namespace) -> int:
    answers, seconds = all_answers(questions(options.part, options.every), options.jobs)
    write(options.file, {"libraries": libraries(), "answers": answers})
    counts = {part: len(of) for part, of in answers.items()}
    sys.stdout.write("".join(f"{part}: {counts[part]} answers, {seconds[part]:.0f} s of CPU\n" for part in counts))
    return 0


def _compare(options: argparse.Namespace) -> int:
    stored = read(options.file)
    asked = questions(options.part, options.every)
    if options.other:
        after = read(options.other)
        now, new = after["libraries"], _chosen(after["answers"], asked)
    else:
        now, new = libraries(), all_answers(asked, options.jobs)[0]
    if stored["libraries"] != now:
        sys.stdout.write(f"note: stored with {stored['libraries']}, compared with {now}\n")
    lines = differences(_chosen(stored["answers"], asked), new)
    compared = ", ".join(f"{len(of)} of {part}" for part, of in new.items())
    sys.stdout.write("\n".join(lines or [f"{compared}: all the same to the last digit"]) + "\n")
    return 1 if lines else 0


def _chosen(answers: Answer, asked: list[tuple[str, str]]) -> Answer:
    wanted = set(asked)
    return {part: {name: x for name, x in of.items() if (part, name) in wanted} for part, of in answers.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("file", type=Path, metavar="FILE", help="of the stored answers")
    common.add_argument("--part", action="append", choices=tuple(ASKED), help="only this one; may be given again")
    common.add_argument("--every", type=int, default=1, metavar="N", help="only every n-th question of each part")
    common.add_argument("--jobs", type=int, default=1, help="processes")
    work = parser.add_subparsers(dest="work", required=True)
    work.add_parser("store", parents=[common], help="ask, and store the answers")
    two = work.add_parser("compare", parents=[common], help="ask again, and tell what differs")
    two.add_argument("--with", dest="other", type=Path, metavar="OTHER", help="stored answers instead of asking")
    options = parser.parse_args()
    options.part = options.part or list(ASKED)
    return _store(options) if options.work == "store" else _compare(options)


if __name__ == "__main__":
    sys.exit(main())
