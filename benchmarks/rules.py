"""SIMC on the test batch of Astrom & Hagglund: robustness, and performance against the best PI at the same Ms.

Each process is reduced by the half rule and tuned with tau_c = theta; Ms, J and the best J at that Ms are those of the
full process. No chance in it. Run: python benchmarks/rules.py
"""

import numpy as np

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.optimum import optimal_pi, references
from retuner.adaptive.loop.performance import performance, weighted_cost
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.simc import simc

SLOW = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.3, 1.5, 2.0, 4.0, 6.0, 8.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
TENTHS = tuple(i / 10 for i in range(1, 12))
DELAYS = (0.01, 0.02, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)


def batch() -> dict[str, LinearProcess]:
    """The processes by name (Astrom & Hagglund 2006, Advanced PID control, section 7.2)."""
    found = {f"P1 T={t:g}": LinearProcess(1.0, (t,), (), 1.0) for t in (*SLOW, 1000.0)}
    found |= {f"P2 T={t:g}": LinearProcess(1.0, (t, t), (), 1.0) for t in (0.01, *SLOW)}
    thirds = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 2.0, 5.0, 10.0)
    found |= {f"P3 T={t:g}": LinearProcess(1.0, (1.0, t, t)) for t in thirds}
    found |= {f"P4 n={n}": LinearProcess(1.0, (1.0,) * n) for n in range(3, 9)}
    found |= {f"P5 a={a:g}": LinearProcess(1.0, (1.0, a, a**2, a**3)) for a in TENTHS[:9]}
    lengths = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0)
    found |= {f"P6 L={x:g}": LinearProcess(1.0, (1 - x,), (), x, 1) for x in lengths}
    found |= {f"P7 T={t:g} L={x:g}": LinearProcess(t, (t, 1 - x), (), x) for t in (1.0, 2.0, 5.0, 10.0) for x in DELAYS}
    found |= {f"P8 a={a:g}": LinearProcess(1.0, (1.0, 1.0, 1.0), (-a,)) for a in TENTHS}
    found |= {f"P9 T={t:g}": LinearProcess(1.0, (1.0,), (), 0.0, 0, ((1.4 * t, t * t),)) for t in TENTHS[:10]}
    return found


def main() -> None:
    """Print the distribution of Ms and of J over the best J."""
    peaks, ratios = {}, {}
    for name, process in batch().items():
        gains = simc(half_rule(process)).gains
        peaks[name] = sensitivity_peak(process, gains)
        best = references(process)
        j = weighted_cost(performance(process, gains), best.iae_setpoint, best.iae_load)
        ratios[name] = j / optimal_pi(process, peaks[name]).cost
    ms, ratio = np.array(list(peaks.values())), np.array(list(ratios.values()))
    print(f"{len(ms)} processes, SIMC with tau_c = theta after the half rule")
    print(f"Ms: {ms.min():.2f} to {ms.max():.2f}, median {np.median(ms):.2f}")
    print(f"above 1.8: {', '.join(name for name, value in peaks.items() if value > 1.8)}")
    print(
        f"J over the best PI at the same Ms: median {np.median(ratio):.2f}, 90 % {np.quantile(ratio, 0.9):.2f},"
        f" most {ratio.max():.2f} ({max(ratios, key=lambda name: ratios[name])})"
    )


if __name__ == "__main__":
    main()
