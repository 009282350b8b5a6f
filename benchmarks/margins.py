"""Ms of one loop: time and accuracy against a plain numpy grid of 500 frequencies, on the same loops in one run.

The grid has its frequencies ready and does not ask whether the loop is stable; ours decides stability too. Ratios are
medians over interleaved rounds on the thread's CPU clock. Run: python benchmarks/margins.py
"""

import statistics
import time
from collections.abc import Callable

import numpy as np

from retuner.adaptive.loop.margins import margins, sensitivity_peak
from retuner.adaptive.loop.open_loop import open_loop
from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

ROUNDS, CALLS, SEED, RANDOM_LOOPS = 41, 400, 1, 2000
LOOPS = {
    "first order + delay, PI": (LinearProcess(1.0, (10.0,), (), 3.0), PidGains(1.6, 0.16)),
    "slow first order + delay, PI": (LinearProcess(1.0, (100.0,), (), 1.0), PidGains(50.0, 50.0 / 8)),
    "integrating + delay, PI": (LinearProcess(1.0, (), (), 1.0, 1), PidGains(0.5, 0.0625)),
    "second order + delay, PID": (LinearProcess(1.0, (10.0, 4.0), (), 3.0), PidGains(2.33, 0.167, 6.67)),
    "four equal lags, PI": (LinearProcess(1.0, (1.0, 1.0, 1.0, 1.0)), PidGains(0.3, 0.2)),
}


def plain_grid(process: LinearProcess, gains: PidGains) -> Callable[[], float]:
    """Ms as one writes it in numpy, on 500 frequencies that are there already."""
    w = np.logspace(-3, 2, 500) / (process.theta_s or 1.0)
    kp, ki, kd, k, theta, lags = gains.kp, gains.ki, gains.kd, process.k, process.theta_s, process.lags_s

    def ms() -> float:
        s = 1j * w
        loop = (kp + ki / s + kd * s) * k * np.exp(-theta * s) if kd else (kp + ki / s) * k * np.exp(-theta * s)
        for lag in lags:
            loop = loop / (lag * s + 1)
        if process.integrators:
            loop = loop / s
        return float(np.max(1 / np.abs(1 + loop)))

    return ms


def seconds(work: Callable[[], float]) -> float:
    """CPU seconds of one call."""
    start = time.thread_time()
    for _ in range(CALLS):
        work()
    return (time.thread_time() - start) / CALLS


def exact_ms(process: LinearProcess, gains: PidGains) -> float:
    """Ms on ever finer grids round the peak, to rounding."""
    loop = open_loop(process, gains)
    w = np.geomspace(min(loop.corners()) / 100, 100 * max(loop.corners()), 400_001)
    for _ in range(4):
        i = int(np.argmin(np.abs(1 + loop.along(w))))
        w = np.linspace(w[max(i - 1, 0)], w[min(i + 1, len(w) - 1)], 2001)
    return float(np.max(1 / np.abs(1 + loop.along(w))))


def main() -> None:
    """Print the table and the accuracy over random loops."""
    print(f"{'loop':32} {'grid us':>8} {'ours us':>8} {'ratio':>6} {'grid error':>11} {'our error':>10}")
    for name, (process, gains) in LOOPS.items():
        grid = plain_grid(process, gains)
        pairs = [(seconds(grid), seconds(lambda p=process, g=gains: sensitivity_peak(p, g))) for _ in range(ROUNDS)]
        ratio = statistics.median(b / a for a, b in pairs)
        a, b = (statistics.median(column) * 1e6 for column in zip(*pairs, strict=True))
        exact = exact_ms(process, gains)
        errors = grid() - exact, sensitivity_peak(process, gains) - exact
        print(f"{name:32} {a:8.1f} {b:8.1f} {ratio:6.2f} {errors[0]:11.1e} {errors[1]:10.1e}")
    rng, worst, stable = np.random.default_rng(SEED), 0.0, 0
    for _ in range(RANDOM_LOOPS):
        tau, theta, kc, tau_i = 10 ** rng.uniform((-1, -1, -1, -0.5), (2, 1, 0.5, 1.5))
        process, gains = LinearProcess(1.0, (float(tau),), (), float(theta)), PidGains(float(kc), float(kc / tau_i))
        found = margins(process, gains)
        if found.stable:
            worst, stable = max(worst, abs(sensitivity_peak(process, gains) / found.ms - 1)), stable + 1
    print(
        f"{stable} stable of {RANDOM_LOOPS} random loops (seed {SEED}): the quick and the general method differ by at"
        f" most {worst:.1e}"
    )


if __name__ == "__main__":
    main()
