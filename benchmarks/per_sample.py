"""What does one sample cost? Ratios to one call of simple-pid, from interleaved rounds in one process.

    python benchmarks/per_sample.py [ROUNDS]

Every case runs the same number of calls in each round, on thread CPU time; the ratio of a case is the median over the
rounds of its time over simple-pid's in the same round, and beside it the ratio of the two shortest times, which other
work on the machine disturbs least. Goals: a PID step at most 0.5, the quiet path at most 2.0 with one scheduling
variable and 2.5 with two that are filtered. To add a case, write a function that prepares n calls and returns the loop
over them, and list it in CASES.
"""

import math
import random
import statistics
import sys
import time
from collections.abc import Callable

from retuner import GainTable, LoopMode, LoopSample, PidGains, Retuner, RetunerSettings
from retuner.schedule.pid import PidLaw, law, start, step
from retuner.schedule.regions import Axis, Regions, choose, enter

try:
    from simple_pid import PID
except ModuleNotFoundError:
    sys.exit("this benchmark compares with simple-pid; install it: pip install --group bench, or make bench")

CALLS = 20_000
ROUNDS = 31
DT_S = 0.1
SP = 50.0
GAINS = PidGains(1.2, 0.1, 0.5)

Loop = Callable[[], None]


def noisy_pv(n: int, mean: float = SP) -> list[float]:
    """A loop at rest: noise only, so that no output reaches a limit."""
    rng = random.Random(1)
    return [mean + rng.gauss(0.0, 0.2) for _ in range(n)]


def simple_pid(n: int) -> Loop:
    """The base: PID with limits, dt given."""
    pid = PID(GAINS.kp, GAINS.ki, GAINS.kd, SP, sample_time=None, output_limits=(0.0, 100.0), starting_output=50.0)
    pvs = noisy_pv(n)

    def loop() -> None:
        for pv in pvs:
            pid(pv, DT_S)

    return loop


def pid_step(settings: PidLaw, mean: float = SP) -> Callable[[int], Loop]:
    """A step of our law, the state carried from call to call."""

    def prepare(n: int) -> Loop:
        pvs = noisy_pv(n, mean)

        def loop() -> None:
            state, _ = step(settings, start(settings, SP, mean, 50.0), SP, mean, DT_S)
            for pv in pvs:
                state, _ = step(settings, state, SP, pv, DT_S)

        return loop

    return prepare


REGIONS = Regions("pv", "degC", ("cold", "warm", "hot"), 20.0, (40.0, 120.0), 220.0, 2.0, 60.0)


def choose_region(n: int) -> Loop:
    """The region stays, as it nearly always does."""
    settings, pvs = REGIONS.law(), noisy_pv(n)

    def loop() -> None:
        state = enter(settings, SP, 0.0)
        for pv in pvs:
            state = choose(settings, state, pv, 1.0)

    return loop


MAP = Regions.along(
    tuple("abcdefghi"),
    Axis("pv", "degC", 20.0, (40.0, 120.0), 220.0, 2.0, 60.0, 5.0),
    Axis("can", "%", 0.0, (30.0, 60.0), 100.0, 2.0, 0.0, 5.0, "flow"),
)


def choose_cell(n: int) -> Loop:
    """The same on a map of two filtered axes: two filters move at each sample."""
    settings, pvs = MAP.law(), noisy_pv(n)

    def loop() -> None:
        state = enter(settings, SP, 0.0, SP)
        for i, pv in enumerate(pvs):
            state = choose(settings, state, pv, i * DT_S, pv)

    return loop


def quiet_path(regions: Regions) -> Callable[[int], Loop]:
    """Retuner.observe of a loop at rest: region, noise band, recogniser, memory. The samples are made beforehand."""

    def prepare(n: int) -> Loop:
        table = GainTable("oven", regions, (GAINS,) * len(regions))
        pvs = noisy_pv(2 * n)
        samples = [LoopSample(i * DT_S, SP, pv, 50.0, LoopMode.AUTO, 0, pv, 0, pv) for i, pv in enumerate(pvs)]
        retuner = Retuner(table, RetunerSettings(sample_time_s=DT_S, pv_span=200.0))
        for sample in samples[:n]:
            retuner.observe(sample)

        def loop() -> None:
            for sample in samples[n:]:
                retuner.observe(sample)

        return loop

    return prepare


CASES: dict[str, Callable[[int], Loop]] = {
    "simple-pid call, limits": simple_pid,
    "PID step: b, filtered D, range": pid_step(law(GAINS, b=0.8, tau_f_s=0.5)),
    "PID step: and a rate limit": pid_step(law(GAINS, b=0.8, tau_f_s=0.5, co_rate_per_s=1e3)),
    "PID step: at the upper limit": pid_step(law(GAINS, b=0.8, tau_f_s=0.5), mean=-200.0),
    "region choice, no change": choose_region,
    "cell choice, two filtered axes": choose_cell,
    "Retuner.observe, quiet": quiet_path(REGIONS),
    "Retuner.observe, two variables": quiet_path(MAP),
}


def measure(rounds: int) -> dict[str, list[float]]:
    """Nanoseconds a call, per case and round; the first round warms up and is left out."""
    times: dict[str, list[float]] = {name: [] for name in CASES}
    for _ in range(rounds + 1):
        for name, prepare in CASES.items():
            begin = time.thread_time_ns()
            prepare(CALLS)()
            times[name].append((time.thread_time_ns() - begin) / CALLS)
    return {name: values[1:] for name, values in times.items()}


def main() -> None:
    times = measure(int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS)
    base = times[next(iter(CASES))]
    print(f"{'case':<34}{'ns a call':>10}{'x simple-pid':>14}{'(quartiles)':>16}{'best':>8}")
    for name, values in times.items():
        ratios = sorted(value / reference for value, reference in zip(values, base, strict=True))
        low, high = ratios[len(ratios) // 4], ratios[math.ceil(3 * len(ratios) / 4) - 1]
        best = min(values) / min(base)
        spread = f"({low:.2f}-{high:.2f})"
        print(f"{name:<34}{statistics.median(values):>10.0f}{statistics.median(ratios):>14.2f}{spread:>16}{best:>8.2f}")


if __name__ == "__main__":
    main()
