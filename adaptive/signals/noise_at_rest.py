"""What pv did while nothing happened before a response: noise that wanders, which differences of neighbours do not see.

The streaming estimate of noise.py sees a third of noise with a memory of ten samples. A band made of it is too narrow:
noise passes for responses, a loop at rest for a restless one, and what a good model leaves for another cause. So with
every response the samples before it are looked at once more, at longer lags.
"""

from collections.abc import Sequence

import numpy as np

from retuner.adaptive.signals.noise import coloured_sigma
from retuner.adaptive.signals.recogniser import START_BANDS
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample

FEWEST_SAMPLES_AT_REST = 60
"""Samples at rest of which noise that wanders is told."""
OUTSIDE = 0.05
"""Share of them that may lie outside of what begins a response: the band is too narrow for such noise."""
PARTS = 8
"""What is slower than this part of a response is a load to it, and no noise."""


def wander_before(samples: Sequence[LoopSample], response: Response) -> float:
    """Standard deviation of noise that wanders, pv units; zero where it is white, or the loop was not at rest for long.

    samples : kept, the newest last, with the response at their end.
    """
    # pv from the last motion on, or the last change of setpoint or gains, until the response
    near, outside, found = START_BANDS * response.band, 0, list[float]()
    before = [sample for sample in samples if sample.t_s < response.t_start_s]
    for sample in reversed(before):
        outside += abs(sample.sp - sample.pv) > near
        same = sample.sp == before[-1].sp and sample.revision == before[-1].revision
        if not same or outside > max(OUTSIDE * len(found), 1):
            break
        found.append(sample.pv)
    rest = np.array(found)
    if len(rest) < FEWEST_SAMPLES_AT_REST:
        return 0.0
    length = sum(sample.t_s >= response.t_start_s for sample in samples)
    return coloured_sigma(rest, length // PARTS)
