"""How much the error moves while nothing happens: what a load that never rests, or slow noise, adds to any response.

    wander = quantile over blocks of the standard deviation of sp - pv about a straight line

over blocks of BLOCK samples under the gains in force. A quarter of the blocks lie below the quantile: upsets that come
and go leave quiet blocks, a load that wanders leaves none. The line takes away what a slow integral has still to bring
back. A loop that swings by its own fault leaves no quiet block either, so it gives no measure (see prediction.py).
Three of four blocks stay below the largest |sp - pv| that a load makes: a half wave within it is no sign of a runaway.
(By the quiet quarter of the blocks 7 of 100 good sets ran away; those that really do go far beyond.)

A set for another place has not run yet. A load that is a random walk moves the error there as its unit step does, with
the variance of its increments times the integral of the squared response. So what is seen here beside noise is carried
over by the root of the ratio of these integrals, on the models of both places.

    wander there = sqrt(noise^2 + (wander here^2 - noise^2) ISE there / ISE here)
"""

import math
from collections.abc import Sequence
from itertools import islice, takewhile

import numpy as np

from retuner.adaptive.signals.sample import LoopSample, quantile
from retuner.adaptive.trial.batch_responses import ClosedLoop, Upset, traces

BLOCK = 100  # samples of a block: some dead times of a loop that is sampled as it should be
FEWEST_BLOCKS = 4  # blocks without which nothing is said
QUIET, USUAL = 0.25, 0.75  # shares of the blocks: in which less happens, and that hold what a load does in all


def load_variability(samples: Sequence[LoopSample]) -> tuple[float, float]:
    """Of the error, pv units; zeros where it is not known: its standard deviation about a straight line in the quieter
    blocks, and its largest value in all but the loudest quarter.

    samples : the newest last; those under other gains than the newest one's do not count.
    """
    own = list(takewhile(lambda sample: sample.revision == samples[-1].revision, reversed(samples)))
    blocks = len(own) // BLOCK
    if blocks < FEWEST_BLOCKS:
        return 0.0, 0.0
    error = np.array([sample.sp - sample.pv for sample in islice(own, blocks * BLOCK)]).reshape(blocks, BLOCK)
    line = np.stack([np.full(BLOCK, BLOCK**-0.5), np.linspace(-1.0, 1.0, BLOCK)])
    line[1] /= np.linalg.norm(line[1])
    left = error - error @ line.T @ line
    return quantile(np.std(left, axis=1), QUIET), quantile(np.max(np.abs(error), axis=1), USUAL)


def load_variability_there(seen: float, noise_std: float, here: ClosedLoop, there: ClosedLoop) -> float:
    """What `seen` (load_variability) under one loop would be under another, pv units. noise_std : of pv."""
    if seen <= noise_std:
        return seen
    rows = traces((here, there), (Upset(load_step=1.0),))
    now, then = (float(row[0].step_s * (row[0].e @ row[0].e)) for row in rows)
    return math.sqrt(noise_std**2 + (seen**2 - noise_std**2) * then / now)
