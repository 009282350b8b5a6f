"""Time of the screening by the classic indexes and of reading off the settings in force, per record and per index.

    python benchmarks/indexes.py [SAMPLES] [--rounds 20] [--seed 7]

Records are a sticking valve's and a noisy one without an oscillation; medians of interleaved rounds, CPU time. Times
are given in ms and as a ratio to one FFT of the record (numpy.fft.rfft, the power of two above twice its length).
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np

from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.indexes.autocovariance import decay_ratio, regularity
from retuner.adaptive.indexes.bicoherence import bicoherence
from retuner.adaptive.indexes.condition import record_condition
from retuner.adaptive.indexes.half_wave import half_wave_shape
from retuner.adaptive.indexes.harmonics import refined_frequency, tones
from retuner.adaptive.indexes.jumps import flat_share, jump_share
from retuner.adaptive.indexes.recording_quality import recording_quality
from retuner.adaptive.indexes.screening import screen
from retuner.adaptive.indexes.shapes import cross_correlation, ellipse, yamashita
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

PERIOD = 50


def records(n: int, seed: int) -> dict[str, Window]:
    """A limit cycle and a quiet loop, n samples each."""
    rng = np.random.default_rng(seed)
    t, zero = np.arange(float(n)), np.zeros(n)
    square = np.where((t / PERIOD) % 1.0 < 0.5, 1.0, -1.0) + 0.1 * rng.normal(size=n)
    integral = np.cumsum(-square) / 20
    quiet = np.convolve(rng.normal(size=n + 30), np.exp(-np.arange(31) / 8), "valid")[:n]
    return {
        "sticking valve": Window(t, zero, square, -0.3 * square + integral),
        "disturbed loop": Window(t, zero, quiet, -0.3 * quiet - np.cumsum(quiet) / 50),
    }


def cases(record: Window) -> dict[str, Callable[[], object]]:
    """What is timed."""
    pv, co, t = record.pv, record.co, record.t_s
    w = 2 * np.pi / PERIOD
    length = 1 << (2 * len(pv) - 1).bit_length()
    return {
        "one FFT": lambda: np.fft.rfft(pv, length),
        "screen, all indexes": lambda: screen(record, PidGains(0.3, 0.02)),
        "settings in force": lambda: settings_in_force(record),
        "regularity": lambda: regularity(pv),
        "decay ratio": lambda: decay_ratio(pv),
        "half waves": lambda: half_wave_shape(pv, 0.3),
        "frequency": lambda: refined_frequency(t, pv, w),
        "harmonics": lambda: tones(t, w, pv, co),
        "cross-correlation": lambda: cross_correlation(pv, co),
        "bicoherence": lambda: bicoherence(pv),
        "ellipse": lambda: ellipse(pv, co),
        "Yamashita": lambda: yamashita(pv, co),
        "jumps": lambda: (jump_share(pv, co), flat_share(pv, co, 3)),
        "recording quality": lambda: recording_quality(pv),
        "condition": lambda: record_condition(record),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("samples", type=int, nargs="?", default=1000)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    print(f"{options.samples} samples, {options.rounds} rounds, seed {options.seed}: CPU time, median")
    for name, record in records(options.samples, options.seed).items():
        timed: dict[str, list[float]] = {case: [] for case in cases(record)}
        for _ in range(options.rounds + 1):
            for case, work in cases(record).items():
                start = time.process_time_ns()
                work()
                timed[case].append((time.process_time_ns() - start) / 1e6)
        base = statistics.median(timed["one FFT"][1:])
        print(name)
        for case, times in timed.items():
            ms = statistics.median(times[1:])
            print(f"  {case:<22} {ms:8.2f} ms   {ms / base:6.1f} FFTs")


if __name__ == "__main__":
    main()
