"""What a record, a command and a decision cost, as ratios in one run, against the last ratios on record.

    python benchmarks/costs.py [--rounds 3] [--only NAME ...] [--note "why"]

CPU time of this process or of the command's; the shortest of interleaved rounds. Records and commands are counted in
`python -c "import numpy"` of the same round, parts of the engine in the same part computed by numpy, an examination in
samples of the device, a quiet sample in calls and files, a frame in python-can's own. Records are drawn from a seed of
its own (benchmarks/cases), 1,000 samples or so each. Prints each ratio beside the last one in costs.toml and exits 1
where one is worse by more than a tenth; --note puts this run there, with its reason, in place of older ratios. On a
machine that does something else as well, ratios differ by a fifth from run to run: more rounds help.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import can
from bus_simulation.device_end import LagPlant
from bus_simulation.in_thread import InThread
from cases import diagnosis
from startup import RUN, cpu_s, write_record

from retuner import PidGains, diagnose, identify
from retuner.adaptive.explanations.valve_odds import log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import Prepared, log_likelihood
from retuner.adaptive.fit import engine
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.plateaus import as_steps
from retuner.config.loading import load_session
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.conformance.chapters import chapters
from retuner.drivers.conformance.conversation import Conversation
from retuner.drivers.conformance.examination import examine
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import GainBox
from retuner.session.running import Run, nothing

HISTORY = Path(__file__).with_suffix(".toml")
WORSE = 1.1
SEED, RECORDS = 4040, 8
HELP = ("", "run", "report", "approve", "replay", "experiment", "identify", "diagnose", "audit", "schedule")
SETTLED_SAMPLES = 136  # After so many no stamp of the lease is waited for
QUIET_FROM, QUIET = 300, 100
"""Samples of the oven before its first step, when its host has settled, and how many are looked at."""
BURST, BURSTS = 64, 500  # Frames between two looks at the bus, and how often


def spent(work: Callable[[], object]) -> float:
    """CPU seconds of this process."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def on_records(base: float) -> Iterator[tuple[str, float]]:
    """identify with gains told and diagnose without, in Python: median and worst record."""
    known = [(case.record, case.gains) for case in map(partial(diagnosis.case, SEED), range(RECORDS))]
    works = {
        "identify": [partial(identify, *record, gains=gains) for record, gains in known],
        "diagnose": [partial(diagnose, *record) for record, _ in known],
    }
    for name, each in works.items():
        times = [spent(work) for work in each]
        yield f"{name} a record, median", statistics.median(times) / base
        yield f"{name} a record, worst", max(times) / base


def of_engine(_: float) -> Iterator[tuple[str, float]]:
    """Parts that the compiled engine computes, over numpy."""
    window = Window(*diagnosis.case(SEED, 0).record)
    record = Prepared.at(window, window.sample_time_s)
    parts: dict[str, Callable[[], object]] = {
        "likelihood of the grid": lambda: log_likelihood(record, 1, 1.0),
        "odds of a valve": lambda: log_odds_of_valve([record], 1),
        "plateaus": lambda: as_steps(record.pv),
    }
    for name, work in parts.items():
        found = {}
        for which in ("c", "numpy"):
            with engine.using(which):
                work()
                found[which] = spent(work)
        yield f"engine / numpy: {name}", found["c"] / found["numpy"]


def of_commands(base: float) -> Iterator[tuple[str, float]]:
    """Commands and imports over `import numpy`."""
    yield "from retuner import Retuner", cpu_s(["-c", "from retuner import Retuner"]) / base
    for name in HELP:
        given = [*([name] if name else []), "--help"]
        yield " ".join(["retuner", *given]), cpu_s(["-c", RUN.format(given)]) / base
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "record.csv")
        write_record(path)
        for name in ("identify", "diagnose"):
            given = [name, str(path), "--kc", "1", "--tau-i", "15", "--json"]
            yield f"retuner {name} FILE", cpu_s(["-c", RUN.format(given)]) / base


def on_line(base: float) -> Iterator[tuple[str, float]]:
    """A decision of PidController in a process of its own (decisions.py): median and worst, after the first."""
    program = [sys.executable, "-P", str(HISTORY.with_name("decisions.py"))]
    decided = json.loads(subprocess.run(program, stdout=subprocess.PIPE, check=True).stdout)[1:]
    yield "a decision on line, median", statistics.median(decided) / base
    yield "a decision on line, worst", max(decided) / base


def of_session(_: float) -> Iterator[tuple[str, float]]:
    """Python functions that a quiet sample of a simulated run calls at its host, and the files that they stand in."""
    turns: list[list[str]] = []
    config, _text = load_session(HISTORY.parents[1] / "examples" / "oven.toml")
    with Run(config, nothing).bench() as (session, bench):
        for _turn in range(QUIET_FROM + QUIET):
            bench.turn()
            called: list[str] = []
            sys.setprofile(
                lambda frame, event, _, to=called: to.append(frame.f_code.co_filename) if event == "call" else None
            )
            session.poll(bench.clock.now_s())
            sys.setprofile(None)
            turns.append(called)
    yield "a quiet sample, calls", statistics.median(len(called) for called in turns[QUIET_FROM:])
    yield "a quiet sample, files", statistics.median(len(set(called)) for called in turns[QUIET_FROM:])


def of_demo(base: float) -> Iterator[tuple[str, float]]:
    """What `make demo` runs, without its page server: the virtual oven retuned, with a report."""
    with tempfile.TemporaryDirectory() as folder:
        given = ["run", str(HISTORY.parents[1] / "examples" / "oven.toml"), "--out", str(Path(folder, "run")), "--json"]
        yield "the demo", cpu_s(["-c", RUN.format(given)]) / base


def of_plant(_: float) -> Iterator[tuple[str, float]]:
    """A month of loops in Parquet over arrow's own reading: read, and read and screened."""
    sys.path.append(str(HISTORY.parent / "audit"))
    from audit import made_plant, screening

    with tempfile.TemporaryDirectory() as folder:
        spent_on = screening(Path(folder, "unit001.parquet"), made_plant(Path(folder), 20, 30.0, SEED))
    yield "a month of Parquet, read", spent_on["read"]
    yield "a month of Parquet, read and screened", spent_on["read"] + spent_on["screen"]


def of_examination(_: float) -> Iterator[tuple[str, float]]:
    """Controller samples that `retuner conformance` takes of a device that has run for a while; its time is theirs."""
    box = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0)
    device = VirtualDevice(VirtualDeviceSettings(PidGains(1.0, 0.0625, 0.25), box=box, trial_samples=0), LagPlant())
    for _sample in range(SETTLED_SAMPLES):
        device.step()
    before = device.sample
    examine(Conversation(InThread(device), 1), chapters()[:-1])  # without the restart
    yield "an examination, samples", device.sample - before


def on_bus(_: float) -> Iterator[tuple[str, float]]:
    """A frame made, sent, received and read, over python-can's own Message, send and recv, on its virtual bus."""
    codec, clock = Codec(1), SimulatedClock()
    message = VirtualDevice(VirtualDeviceSettings(PidGains(2.0, 0.25)), LagPlant()).step()[-1]
    frame, id_, data = codec.decode(message), message.arbitration_id, bytes(message.data)

    def bare() -> None:
        for _ in range(BURST):
            a.send(can.Message(arbitration_id=id_, is_extended_id=False, data=data), timeout=0.05)
        while b.recv(timeout=0.0) is not None:
            pass

    def ours() -> None:
        for _ in range(BURST):
            far.send(codec.encode(frame))
        for received in near.receive_all():
            codec.decode(received)

    with can.Bus(interface="virtual", channel="bare") as a, can.Bus(interface="virtual", channel="bare") as b:
        near, far = (CanLink(LinkSettings(channel="ours"), clock) for _ in range(2))
        times = [(spent(ours), spent(bare)) for _ in range(BURSTS)]
        near.close()
        far.close()
    yield "a frame over python-can's", statistics.median(ours_s / bare_s for ours_s, bare_s in times)


GROUPS = {
    "records": on_records, "engine": of_engine, "commands": of_commands, "online": on_line, "session": of_session,
    "demo": of_demo, "plant": of_plant, "examination": of_examination, "bus": on_bus,
}  # fmt: skip


def measured(rounds: int, only: list[str]) -> dict[str, float]:
    """The smallest ratio of each name over the rounds, each with a base of its own."""
    found: dict[str, float] = {}
    for _ in range(rounds):
        for group in only:
            base = min(cpu_s(["-c", "import numpy"]) for _ in range(3))
            for name, ratio in GROUPS[group](base):
                found[name] = min(ratio, found.get(name, ratio))
    return found


def history() -> list[dict[str, Any]]:
    """The runs on record, oldest first."""
    return tomllib.loads(HISTORY.read_text(encoding="utf-8"))["run"]


def keep(found: dict[str, float], note: str) -> None:
    """Write this run behind those on record, each with the ratios that no later run has."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout
    this = {"day": f"{datetime.now(UTC):%Y-%m-%d}", "commit": commit.strip(), "note": note, "ratios": found}
    lines = ["# The last ratios of benchmarks/costs.py, by the run that measured them; --note adds a run."]
    for run in [*history(), this]:
        last = {name: ratio for name, ratio in run["ratios"].items() if run is this or name not in found}
        if last:
            lines += ["", "[[run]]", *(f"{key} = {json.dumps(run[key])}" for key in ("day", "commit", "note"))]
            lines += ["[run.ratios]", *(f'"{name}" = {ratio:.3g}' for name, ratio in last.items())]
    HISTORY.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> int:
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    parser.add_argument("--note", help="put this run on record, with the reason")
    options = parser.parse_args()
    runs, worse = history(), 0
    found = measured(options.rounds, options.only)
    for name, ratio in found.items():
        before = next((run["ratios"][name] for run in runs if name in run["ratios"]), None)
        bad = before is not None and ratio > WORSE * before
        worse += bad
        was = f"{before:8.3g}" if before is not None else "       -"
        sys.stdout.write(f"{name:36} {was} -> {ratio:8.3g}{'  WORSE' if bad else ''}\n")
    if options.note:
        keep(found, options.note)
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
