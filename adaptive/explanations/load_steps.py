"""Loads that are steps, as a fit of one response has them: what that says of every process of the grid.

    ln L(cell) = ln L_fit - d^2 / 2,      d of ln|G(jw)| and arg G(jw), cell less fit, at SEEN_AT of the phase crossover

The process of the fit lies between those of the grid, and an error of 5 % in a gain or lag is large beside what a step
leaves. So its likelihood is a Gaussian around it (Laplace), in what a loop sees of a process, and the nearest cell
stands for the fit itself. Its lead over a load that wanders is priced by how many numbers it has (Schwarz 1978).
"""

import math

import numpy as np

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, EVERY_LAG, FREQUENCIES, GAINS, responses_of, shapes
from retuner.adaptive.explanations.wandering_load import LOADS_OF_BOOK, TEMPER, Prepared
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import FloatArray

OWN_NUMBERS, NUMBERS_OF_STEP = 2.0, 2.0
"""Numbers of a fit: start and level, as the process is chosen under a walk as well; size and time of each load step."""
SEEN_AT = (0.33, 0.67, 1.0)  # frequencies at which processes are compared, as shares of the phase crossover
COARSE = 0.1  # standard deviation of ln |G| and arg G by which a process of the grid stands for those around it


def lead_of_steps(left: float, steps: int, samples: int, record: Prepared, likelihood: FloatArray) -> float:
    """Lead, ln, of a fit whose loads are steps over every process under a load that wanders.

    left : mean square of what the fit leaves of a row of the record, its resolution at least. steps : of load, or
    harmonics of a tone. samples : that were fitted; each number costs half of their logarithm (Schwarz 1978).
    """
    rows, numbers = len(record.pv), OWN_NUMBERS + NUMBERS_OF_STEP * steps
    best = TEMPER * float(np.max(likelihood)) + (TEMPER - 1.0) * math.log(len(LOADS_OF_BOOK))  # their price, once
    best = best / rows - 0.5 * math.log(float(np.var(record.pv)))
    price = numbers * math.log(samples) / (2 * samples)
    return samples * (-0.5 * math.log(max(left, record.resolution**2) * rows) - price - best)


def apart(log: LogModel, temper: float, gain_unit: float, sample_time_s: float) -> FloatArray:
    """d^2 of every process of the grid from a fitted one, of the nearest 0; shape (shapes, dead times, gains).

    log : the fitted process, with the covariance of its record. temper : by which that grows. gain_unit,
    sample_time_s : in which loop gains and times of the grid are counted.
    """

    def seen(model: ProcessModel, at: FloatArray = FREQUENCIES) -> FloatArray:
        response = log.sign * model.seen_by_controller(sample_time_s).linear().response(at / sample_time_s)
        return np.array([np.log(np.abs(response)), np.unwrap(np.angle(response))])

    turned = seen(log.model())[1]
    crossover = FREQUENCIES[min(int(np.sum(turned > -math.pi)), len(FREQUENCIES) - 1)]
    index = np.unique(np.clip(np.searchsorted(FREQUENCIES, np.array(SEEN_AT) * crossover), 0, len(FREQUENCIES) - 1))
    at = FREQUENCIES[index]
    fitted = seen(log.model(), at)
    spread = temper * log.covariance_of(lambda model: seen(model, at).ravel()) + COARSE**2 * np.eye(fitted.size)
    grid = responses_of(*np.indices((len(shapes(EVERY_LAG)), len(DEAD_TIMES))))[..., None, index]
    size = np.log(np.abs(grid)) + np.log(GAINS / gain_unit)[:, None] - fitted[0]
    angle = (np.angle(grid) - fitted[1] + math.pi) % (2.0 * math.pi) - math.pi
    off = np.concatenate([size, np.broadcast_to(angle, size.shape)], axis=-1)
    found = np.einsum("...i,ij,...j->...", off, np.linalg.inv(spread), off)
    return np.asarray(found - np.min(found))
