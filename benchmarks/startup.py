"""CPU time of starting a command, as a ratio to `python -c pass`; from interleaved runs, medians.

    python benchmarks/startup.py [ROUNDS]

Prints one line a case and exits 1 when `retuner --help` takes more than the limit.
"""

import os
import statistics
import subprocess
import sys

LIMIT = 15.0  # issue 2: `retuner --help` within 15 x the CPU time of `python -c pass`
ROUNDS = 9
RUN = "import sys; from retuner.cli import main; sys.exit(main({}))"
CASES = {
    "python -c pass": ["-c", "pass"],
    "retuner --help": ["-c", RUN.format(["--help"])],
    "retuner --version": ["-c", RUN.format(["--version"])],
    "retuner check --help": ["-c", RUN.format(["check", "--help"])],
}


def cpu_s(arguments: list[str]) -> float:
    """User and system time of one run of this interpreter."""
    process = subprocess.Popen([sys.executable, "-P", *arguments], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, process.args)
    return usage.ru_utime + usage.ru_stime


def ratios(rounds: int = ROUNDS) -> dict[str, float]:
    """CPU time of each case over that of the first, medians of interleaved rounds."""
    rows = [{name: cpu_s(arguments) for name, arguments in CASES.items()} for _ in range(rounds + 1)][1:]
    first = next(iter(CASES))
    base = statistics.median(row[first] for row in rows)
    return {name: statistics.median(row[name] for row in rows) / base for name in CASES}


def main() -> int:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    found = ratios(rounds)
    for name, ratio in found.items():
        print(f"{name:<22} {ratio:6.1f} x python -c pass")
    return int(found["retuner --help"] > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
