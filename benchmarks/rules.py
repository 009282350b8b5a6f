"""SIMC on the test batch of Astrom & Hagglund: robustness, and performance against the best PI at the same Ms.

Each process is reduced by the half rule and tuned with tau_c = theta; Ms, J and the best J at that Ms are those of the
full process. No chance in it. Run: python benchmarks/rules.py
"""

import numpy as np
from online.rivals import batch

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.optimum import optimal_pi, references
from retuner.adaptive.loop.performance import performance, weighted_cost
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.simc import simc


def main() -> None:
    """Print the distribution of Ms and of J over the best J."""
    peaks, ratios = {}, {}
    for name, process in ((member.name, member.process) for member in batch()):
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
