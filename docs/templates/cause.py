"""Spikes from the transmitter: single values far from their neighbours, and back at once.

    |pv[i] - (pv[i-1] + pv[i+1]) / 2| > LIMIT noise,    and the neighbours agree with one another

No process of any lag does that, so no change of gains cures it. Say here what the cause looks like, which equation
decides, what else looks like it, and why it is not taken for that.
"""

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window

LIMIT = 12.0
"""A spike stands out by so many standard deviations of the noise: 1 in 1e30 if the noise is normal."""
FEWEST = 3
"""Fewer may be something that happened once."""


def spikes(window: Window) -> Diagnosis | None:
    """The verdict, where the record shows it. window : the record, values in their own units."""
    pv, noise = window.pv, noise_sigma(window.pv)
    middle, before, after = pv[1:-1], pv[:-2], pv[2:]
    out = np.abs(middle - (before + after) / 2)
    seen = (out > LIMIT * noise) & (np.abs(after - before) < out / 4)
    if noise <= 0 or np.count_nonzero(seen) < FEWEST:
        return None
    times = ", ".join(f"{t:.4g}" for t in window.t_s[1:-1][seen][:3])
    reason = f"pv has {np.count_nonzero(seen)} spikes of a single sample (at {times} s): look at the transmitter"
    return Diagnosis(Cause.UNKNOWN, 0.9, {"spikes": float(np.count_nonzero(seen))}, reason)
