"""Hostile inputs: what stands in a file or comes over the bus ends in a value or one clear line, never in a traceback.

    python benchmarks/hostile/inputs.py [KIND ...] [--count N] [--seed S]

Kinds, all without names: frames, datagrams, dbc, config, gains, csv, export, ledger, commands. Per kind of file: N
mutants of good examples (mutants.py) and every cut of one. frames: N random and mutated ones at the decoder's, the
device's and the host's door; datagrams: the same for udp_multicast. commands: N/200 of each kind of file through the
command line, which must end in 0, in 1 (the answer is no; a broken ledger), or in 2 with one line on stderr. Prints a
line of JSON per kind; status 1 when anything went wrong. Nightly: --count 100000 for files, 1000000 for frames.
"""

import argparse
import contextlib
import io
import itertools
import json
import math
import random
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields
from importlib.resources import files
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from mutants import cuts, mutant

from retuner import GainTable, PidGains, Regions, cli, load_config
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.protocol.codec import DbcError, Refused, plans_of, read_dbc, schema, schema_text
from retuner.drivers.recorded.recording import ROLES, RecordingError, read_columns
from retuner.errors import ConfigError, LedgerError
from retuner.ledger import Ledger, LedgerReader
from retuner.schedule.document import from_toml, to_toml

ROOT = Path(__file__).resolve().parents[2]
SLOW_S = 1.0  # an input that takes longer than this hangs a command
COMMANDS_SHARE = 200
TABLE = GainTable(
    "loop",
    Regions("sp", "-", ("low", "high"), 0.0, (50.0,), 100.0, 1.0, 0.0),
    (PidGains(1.25, 0.125, 0.5), PidGains(2.5, 0.25)),
)

Judge = Callable[[bytes], str]  # Takes an input; "refused" or "accepted", or raises Wrong


class WrongError(Exception):
    """An input that did not end as it must."""


def one_line(error: Exception) -> str:
    """The message of a refusal, which must be one line that can be read."""
    lines = getattr(error, "lines", None) or (str(error),)
    for line in lines:
        if not line.strip() or (not line.isprintable() and "\n" in line):
            raise WrongError(f"refused by {line!r}")
    return "refused"


def config(path: Path) -> Judge:
    def judge(data: bytes) -> str:
        path.write_bytes(data)
        try:
            read = load_config(path)
        except ConfigError as error:
            return one_line(error)
        if not all(math.isfinite(v) for v in numbers(read.model_dump())):
            raise WrongError("a number that is not finite was taken")
        return "accepted"

    return judge


def numbers(value: object) -> Iterator[float]:
    """All floats inside."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for inner in value:
            yield from numbers(inner)
    elif isinstance(value, float):
        yield value


def gains(data: bytes) -> str:
    """A gain table; a cut one must not be another table (judged in cut_gains)."""
    try:
        table = from_toml(data.decode("utf-8"))
    except ValueError as error:
        return one_line(error)
    if not all(math.isfinite(v) for g in table.gains for v in (g.kp, g.ki, g.kd)):
        raise WrongError("a gain that is not finite was taken")
    return "accepted"


def cut_gains(data: bytes) -> str:
    """A cut of a good table: refused, or the same table."""
    answer = gains(data)
    if answer == "accepted" and from_toml(data.decode("utf-8")) != TABLE:
        raise WrongError("half a table was taken for another one")
    return answer


def recording(path: Path) -> Judge:
    def judge(data: bytes) -> str:
        path.write_bytes(data)
        try:
            read = read_columns(path, [*ROLES], ["t", "pv", "co"])
        except RecordingError as error:
            return one_line(error)
        if not all(math.isfinite(v) for values in read.values() for v in values):
            raise WrongError("a number that is not finite was taken")
        return "accepted"

    return judge


def exported(path: Path) -> Judge:
    """A record as a plant exports it."""

    def judge(data: bytes) -> str:
        path.write_bytes(data)
        try:
            read = read_loop_record([path]).recording
        except RecordingError as error:
            return one_line(error)
        if not all(math.isfinite(v) for values in (read.t_s, read.pv, read.co) for v in values):
            raise WrongError("a number that is not finite was taken")
        return "accepted"

    return judge


def ledger(path: Path, good: bytes) -> Judge:
    """A ledger: refused, broken, or what it was."""
    path.write_bytes(good)
    with LedgerReader(path) as reader:
        rows, head = list(reader.rows()), reader.head()

    def judge(data: bytes) -> str:
        for leftover in (f"{path.name}-wal", f"{path.name}-shm"):
            path.with_name(leftover).unlink(missing_ok=True)
        path.write_bytes(data)
        try:
            with LedgerReader(path) as reader:
                report = reader.verify()
                if report.ok and (list(reader.rows()), reader.head()) != (rows, head):
                    raise WrongError("another ledger was believed")
        except LedgerError as error:
            return one_line(error)
        return "accepted" if report.ok else "broken"

    return judge


def dbc(data: bytes) -> str:
    """A DBC: refused, or of another layout hash, or the layout that it was."""
    try:
        plans = plans_of(read_dbc(data.decode("ascii", errors="replace"), "x.dbc"), "x.dbc")
    except DbcError as error:
        return one_line(error)
    same = zlib.crc32(schema_text(plans).encode()) & 0xFFFF == schema()
    if same and layouts(plans) != layouts(
        plans_of(read_dbc(files("retuner.drivers").joinpath("retuner.dbc").read_text("ascii"), "retuner.dbc"), "x.dbc")
    ):
        raise WrongError("another layout has the same hash")
    return "accepted" if same else "another hash"


def layouts(plans: dict) -> list:
    """Places and scales of all signals."""
    return [
        (
            command,
            plan.layout.length,
            [(s.name, s.start, s.length, s.is_signed, s.is_float, s.scale, s.offset) for s in plan.layout.signals],
        )
        for command, plan in sorted(plans.items())
    ]


def good_csv() -> bytes:
    rows = [f"{0.5 * i},{50 + i % 3},{50 - 0.25 * i},{30 + i}" for i in range(30)]
    return ("t,sp,pv,co\n" + "\n".join(rows) + "\n").encode()


def examples(folder: Path) -> dict[str, tuple[bytes, Judge, Judge]]:
    """Per kind: a good example, who judges its mutants, who judges its cuts."""
    shipped = files("retuner.drivers").joinpath("retuner.dbc").read_bytes()
    path = folder / "good.sqlite"
    with Ledger(path) as made:
        for i in range(8):
            made.append("decision", {"gains": {"kp": 0.1 * i, "ki": 1e-3}, "why": "x" * 30}, float(i))
    oven, csv, sqlite = (ROOT / "examples" / "oven.toml").read_bytes(), good_csv(), path.read_bytes()
    configs, recordings = config(folder / "x.toml"), recording(folder / "x.csv")
    ledgers, exports = ledger(folder / "x.sqlite", sqlite), exported(folder / "FIC1.csv")
    # A small record as a historian writes it: preamble, tags, units, stamps, decimal comma, a missing value
    rows = [f"14.03.2024 21:5{i // 6}:{i % 6}0;{50 + i % 3},5;{50 - i},25;{30 + i},0;AUTO" for i in range(30)]
    rows[7] = rows[7].replace("43,25", "Bad")
    head = "Export of the plant\n\nZeit;FIC1.SP;FIC1.PV;FIC1.OP;FIC1.MODE\n;m3/h;m3/h;%;\n"
    return {
        "dbc": (shipped, dbc, dbc),
        "config": (oven, configs, configs),
        "gains": (to_toml(TABLE).encode(), gains, cut_gains),
        "csv": (csv, recordings, recordings),
        "export": ((head + "\n".join(rows) + "\n").encode("latin-1"), exports, exports),
        "ledger": (sqlite, ledgers, ledgers),
    }


def judged(inputs: Iterator[bytes], judge: Judge, wrong: list[str]) -> Counter[str]:
    answers: Counter[str] = Counter()
    for i, data in enumerate(inputs):
        started = time.process_time()
        try:
            answers[judge(data)] += 1
        except Exception as error:  # noqa: BLE001  any exception is what is looked for
            wrong.append(f"input {i}: {type(error).__name__}: {error}"[:300])
        if time.process_time() - started > SLOW_S:
            wrong.append(f"input {i} took {time.process_time() - started:.1f} s")
    return answers


def file_kind(
    name: str, example: tuple[bytes, Judge, Judge], count: int, cut_every: int, rng: random.Random
) -> dict[str, object]:
    """Mutants and cuts of one kind of file."""
    good, judge, judge_cut = example
    wrong: list[str] = []
    if judge(good) != "accepted":
        wrong.append("the good example was not taken")
    mutants = judged((mutant(good, rng) for _ in range(count)), judge, wrong)
    cut = judged(itertools.islice(cuts(good), 0, None, cut_every), judge_cut, wrong)
    return {"kind": name, "mutants": dict(mutants), "cuts": dict(cut), "wrong": wrong[:10]}


def frames(count: int, rng: random.Random) -> dict[str, object]:
    """Random and mutated frames at the decoder's door, and at those of a device and a host at work."""
    from doors import Doors  # it needs the whole stack

    doors, wrong = Doors(), []
    answers: Counter[str] = Counter()
    for i in range(count):
        message = doors.hostile(rng)
        try:
            got = doors.codec.decode(message)
            answers["refused" if isinstance(got, Refused) else "a frame"] += 1
            if not isinstance(got, Refused) and not all(math.isfinite(getattr(got, f.name)) for f in fields(got)):
                wrong.append(f"frame {i}: {got}")
            doors.knock(message)
        except Exception as error:  # noqa: BLE001  any exception is what is looked for
            wrong.append(f"frame {i}: {message}: {type(error).__name__}: {error}")
    wrong += doors.broken()
    return {"kind": "frames", "frames": dict(answers), "wrong": wrong[:10]}


def datagrams(count: int, rng: random.Random) -> dict[str, object]:
    from datagrams import Door, hostile  # needs msgpack

    door, wrong = Door(), []
    answers: Counter[str] = Counter()
    for i in range(count):
        datagram = hostile(rng)
        try:
            answers[door.knock(datagram)] += 1
        except Exception as error:  # noqa: BLE001  any exception is what is looked for
            wrong.append(f"datagram {i}: {datagram[:80]!r}: {type(error).__name__}: {error}")
    return {"kind": "datagrams", "datagrams": dict(answers), "wrong": wrong[:10]}


def commands(count: int, rng: random.Random, folder: Path) -> dict[str, object]:
    kinds = examples(folder)
    lines = {"config": ["check"], "csv": ["identify", "--open-loop"], "ledger": ["ledger", "verify"]}
    wrong: list[str] = []
    statuses: dict[str, Counter[int]] = {kind: Counter() for kind in lines}
    for kind, words in lines.items():
        path = folder / f"command-{kind}"
        for i in range(count):
            path.write_bytes(mutant(kinds[kind][0], rng))
            status, err = run([*words, str(path)])
            statuses[kind][status] += 1
            expected = status in (0, 1) or (status == 2 and err.strip())
            if not expected or "Traceback" in err or (kind != "config" and err.count("\n") > 1):
                wrong.append(f"{kind} {i}: status {status}: {err[:200]}")
    return {"kind": "commands", "statuses": {kind: dict(c) for kind, c in statuses.items()}, "wrong": wrong[:10]}


def run(arguments: list[str]) -> tuple[int, str]:
    out, err, hook = io.StringIO(), io.StringIO(), sys.excepthook
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            return cli.main(arguments), err.getvalue()
    except Exception as error:  # noqa: BLE001  what a person would see as a traceback
        return 70, f"Traceback: {type(error).__name__}: {error}"
    finally:
        sys.excepthook = hook


def main() -> int:
    names = ("frames", "datagrams", "dbc", "config", "gains", "csv", "export", "ledger", "commands")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", help=", ".join(names))
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--cut-every", type=int, default=1, help="cut at every n-th byte (1)")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as scratch:
        folder = Path(scratch)
        kinds = examples(folder)
        for name in chosen.kinds or names:
            rng, started = random.Random(f"{name} {chosen.seed}"), time.monotonic()
            if name == "frames":
                result = frames(chosen.count, rng)
            elif name == "datagrams":
                result = datagrams(chosen.count, rng)
            elif name == "commands":
                result = commands(max(chosen.count // COMMANDS_SHARE, 1), rng, folder)
            else:
                result = file_kind(name, kinds[name], chosen.count, chosen.cut_every, rng)
            result |= {"seed": chosen.seed, "seconds": round(time.monotonic() - started, 1)}
            sys.stdout.write(json.dumps(result) + "\n")
            sys.stdout.flush()
            wrong += len(result["wrong"])
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
