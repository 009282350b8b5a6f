"""May the process swing by itself? A pair of poles with little damping is none of the grid's real lags.

    pv = K e^(-theta s) / (1 + 2 zeta s/w + (s/w)^2) co + z + v,      (1 - q)^m (1 - 2 r cos(w_d) q + r^2 q^2) z = w_z

Load z and noise v are those of wandering_load.py, with the pair in place of the lags: C of the whitening filter A/C has
the roots of r + A(q) A(1/q) inside the unit circle. Where such a process explains a record as well, settings that add
action must be robust on it too: of 14 slow loops on one (zeta 0.15 to 0.45) one got Ms 5.2 where real lags told 1.2.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from retuner.adaptive.explanations.likely_processes import WorthSettings
from retuner.adaptive.explanations.process_grid import DEAD_TIMES
from retuner.adaptive.explanations.valve_odds import LAGS
from retuner.adaptive.explanations.wandering_load import (
    BANDWIDTHS,
    LOADS,
    SLOPE,
    T_LOADS,
    TEMPER,
    VALUE,
    Prepared,
    filtered,
    impulse_response,
    spectrum,
    under_loads,
    unsmoothed,
)
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

DAMPINGS = (0.1, 0.2, 0.3)  # zeta; a pair that is damped better is near two lags of the grid
FREQUENCIES = tuple(np.geomspace(0.03, 1.2, 16).tolist())  # w in rad a sample
DEAD = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0)  # dead times in samples
PRIOR = 0.03  # of a process that swings by itself, before any record
STARTS = 4  # first rows that an unknown start moves
MOST_LEAD = 50.0  # ln of odds that count at the most


def swinging_processes(record: Prepared, direction: int) -> list[tuple[ProcessModel, float]]:
    """The likeliest process of each damping and frequency, with its odds against the likeliest one of real lags."""
    n, raw = len(record.pv), np.stack([record.pv, record.co])
    pv, co = unsmoothed(raw, record.smoothing) if record.smoothing else raw
    lags = (under_loads(record, record.co[None], lag, LOADS, DEAD_TIMES).in_direction(direction) for lag in LAGS)
    best = max(lags, key=np.max)
    at = BANDWIDTHS.index(LOADS[int(np.argmax(best)) // best[0].size][0])
    real = TEMPER * float(np.max(best)) - (n - STARTS) / 2 * math.log(record.size)
    dt, found = record.sample_time_s, []
    for w in FREQUENCIES:
        for zeta in DAMPINGS:
            swings, dead, gain = max(_explained(pv, co, w, zeta, direction, BANDWIDTHS[max(at - 1, 0) : at + 2]))
            model = ProcessModel(ProcessType.SOPDT, gain, dt / w, dt / w, dead * dt, zeta=zeta)
            found.append((model, PRIOR * math.exp(min((swings - real) / T_LOADS, MOST_LEAD))))
    return found


def _explained(
    pv: FloatArray, co: FloatArray, w: float, zeta: float, direction: int, bandwidths: Sequence[float]
) -> Iterator[tuple[float, float, float]]:
    """ln L, dead time in samples and gain of the likeliest, under each load; those near the load beside real lags."""
    n, r, turn = len(pv), math.exp(-zeta * w), w * math.sqrt(1.0 - zeta * zeta)
    pair = np.array([1.0, -2.0 * r * math.cos(turn), r * r])
    side = zeta / math.sqrt(1.0 - zeta * zeta) * math.sin(turn)
    top = (0.0, 1.0 - r * (math.cos(turn) + side), r * (r + side - math.cos(turn)))  # co is held between samples
    moved, at = filtered(spectrum(co), n, impulse_response(top, tuple(pair.tolist()), n)), np.arange(n)
    rows = spectrum(np.stack([pv, *(np.interp(at - dead, at, moved, left=0.0) for dead in DEAD)]))
    for order in (VALUE, SLOPE):
        a = np.convolve(pair, np.poly(np.ones(order)))
        for bandwidth in bandwidths:
            c = np.ones(1)
            if not math.isinf(bandwidth):
                both = np.convolve(a, a[::-1])
                both[len(a) - 1] += abs(np.polyval(a[::-1], np.exp(-1j * bandwidth))) ** 2
                roots = np.roots(both)
                c = np.real(np.poly(roots[np.abs(roots) < 1.0]))
            white = filtered(rows, n, impulse_response(tuple(a.tolist()), tuple(c.tolist()), n))[:, STARTS:]
            with_pv, size = white[1:] @ white[0], np.maximum(np.sum(white[1:] ** 2, axis=1), np.finfo(np.float64).tiny)
            whole = float(white[0] @ white[0])
            left = whole - np.where(with_pv * direction > 0, with_pv**2 / size, 0.0)
            left = np.maximum(left, np.finfo(np.float64).eps * whole + np.finfo(np.float64).tiny)  # all is explained
            best = int(np.argmin(left))
            yield -(n - STARTS) / 2 * math.log(left[best]), DEAD[best], float(with_pv[best] / size[best])


def robust_on(
    processes: list[tuple[ProcessModel, float]], gains: PidGains, sample_time_s: float, settings: WorthSettings
) -> bool:
    """Whether gains are as robust on each of these processes that counts as they must be on others."""
    return all(
        sensitivity_peak(model.seen_by_controller(sample_time_s).linear(), gains) <= settings.ms_bad
        for model, odds in processes
        if odds / (1.0 + odds) > settings.bad_share
    )
