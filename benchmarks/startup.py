"""CPU time of starting, as ratios to `python -c pass` and to `import numpy`: the shortest of interleaved runs.

    python benchmarks/startup.py [ROUNDS]

Prints one line a case and exits 1 when one takes more than its limit. Compiled bytecode is kept between the runs, as
it is wherever a program is used twice (PYTHONDONTWRITEBYTECODE would double the figures). The record is a loop of
1,000 samples with two setpoint changes, made here.
"""

import os
import random
import subprocess
import sys
import tempfile
from collections import deque
from pathlib import Path

BASE, NUMPY = "python -c pass", "import numpy"
IMPORTED = "from retuner import Retuner, identify"
LOOP = "a loop's first step"
FIRST_STEP = """if True:
    from retuner import PidController, PidGains
    PidController(PidGains(2.0, 0.1), dt_s=1.0, pv_range=(0, 100)).step(50.0, 20.0)"""
IDENTIFY = "retuner identify FILE"
LIMITS = {
    "retuner --help": (1.1, NUMPY),  # typer, without rich and pydantic; Python itself starts in 10 ms now that an
    "retuner check --help": (1.1, NUMPY),  # editable install has no import hook: too little to be a measure
    "retuner run --help": (1.2, NUMPY),
    "retuner experiment relay --help": (1.4, NUMPY),  # its many options are told one by one
    IMPORTED: (2.7, NUMPY),  # two hundred dataclasses, whose methods are made when their first objects are
    LOOP: (3.1, NUMPY),  # within 0.5 s where numpy takes 0.11 s
    IDENTIFY: (11, NUMPY),  # 9.5 since loads that jump are hypotheses beside processes and valves
}
ROUNDS = 9
RUN = "import sys; sys.argv[1:] = {}; from retuner.__main__ import main; sys.exit(main())"
KC, TAU_I_S, DT_S = 1.0, 15.0, 0.1


def cases(record: Path) -> dict[str, list[str]]:
    """What is run, by name; the first is the base of all."""
    identify = ["identify", str(record), "--kc", str(KC), "--tau-i", str(TAU_I_S), "--json"]
    return {
        BASE: ["-c", "pass"],
        NUMPY: ["-c", "import numpy"],
        IMPORTED: ["-c", IMPORTED],
        LOOP: ["-c", FIRST_STEP],
        "retuner --help": ["-c", RUN.format(["--help"])],
        "retuner --version": ["-c", RUN.format(["--version"])],
        "retuner check --help": ["-c", RUN.format(["check", "--help"])],
        "retuner run --help": ["-c", RUN.format(["run", "--help"])],
        "retuner experiment relay --help": ["-c", RUN.format(["experiment", "relay", "--help"])],
        IDENTIFY: ["-c", RUN.format(identify)],
    }


def write_record(path: Path) -> None:
    """A PI loop round a lag of 10 s with gain 0.8 and a dead time of 3 s, with noise."""
    rng, late, y, co_integral = random.Random(2), deque([50.0] * 30), 50.0, 50.0
    rows = ["t,sp,pv,co"]
    for i in range(1000):
        sp = 50.0 if i < 100 else 60.0 if i < 550 else 55.0
        pv = y + rng.gauss(0.0, 0.05)
        co_integral += KC * (sp - pv) * DT_S / TAU_I_S
        co = KC * (sp - pv) + co_integral
        rows.append(f"{i * DT_S:.1f},{sp},{pv:.5f},{co:.5f}")
        late.append(co)
        y += DT_S / 10.0 * (0.8 * (late.popleft() - 50.0) + 50.0 - y)
    path.write_text("\n".join(rows) + "\n")


def cpu_s(arguments: list[str]) -> float:
    """User and system time of one run of this interpreter."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    kept["OPENBLAS_NUM_THREADS"] = "1"  # numpy takes 120 to 155 ms with threads, which only its import starts, else 83
    process = subprocess.Popen([sys.executable, "-P", *arguments], stdout=subprocess.DEVNULL, env=kept)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, process.args)
    return usage.ru_utime + usage.ru_stime


def shortest_s(rounds: int) -> dict[str, float]:
    """The shortest CPU time of each case, which other work on the machine disturbs least; the first round warms up."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record.csv"
        write_record(record)
        commands = cases(record)
        rows = [{name: cpu_s(arguments) for name, arguments in commands.items()} for _ in range(rounds + 1)][1:]
    return {name: min(row[name] for row in rows) for name in commands}


def main() -> int:
    found = shortest_s(int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS)
    print(f"{'case':<40}{'ms':>6}{'x pass':>9}{'x numpy':>9}  limit")
    passed = True
    for name, value in found.items():
        most, base = LIMITS.get(name, (float("inf"), BASE))
        passed &= value <= most * found[base]
        limit = f"{most:g} x {base}" if name in LIMITS else ""
        print(f"{name:<40}{value * 1e3:6.0f}{value / found[BASE]:9.1f}{value / found[NUMPY]:9.2f}  {limit}".rstrip())
    return int(not passed)


if __name__ == "__main__":
    sys.exit(main())
