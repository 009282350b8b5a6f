"""The PI controller with the most integral action that keeps an Ms, for a stable process.

    maximise ki = kc/tau_I   subject to   |1 + kc z(w)| >= 1/Ms at every w,   z = G(jw) (1 + 1/(jw tau_I))

1/ki is the integrated error after a load step (Astrom, Panagopoulos & Hagglund 1998, Automatica 34(5), 585-601). At a
frequency and a tau_I the constraint is a quadratic in kc, so the largest kc on the way up from 0 is exact:

    kc = min over w of   (-Re z - sqrt((Re z)^2 - |z|^2 (1 - 1/Ms^2))) / |z|^2    where Re z < 0 and the root is real

On the way up from 0 a loop on a stable process is stable, so nothing else has to be asked. Where lags dominate, such a
controller swings slowly; it is for dead times, inverse responses and processes that swing by themselves.
"""

import math

import numpy as np

from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

PER_DECADE = 200  # frequencies to a decade: Ms is then right to a part in a thousand
SLOWEST, FASTEST = 0.02, 30.0  # frequencies looked at, times the sum of all times, and over the shortest that counts
COUNTS = 0.01  # share of the sum of all times from which a time counts for the fastest frequency
SHORTEST, LONGEST = 0.02, 4.0
"""Range of tau_I over the sum of all times: from hardly more than an integral to where lags dominate."""
INTEGRAL_TIMES = 60  # integral times tried: 9 % apart, and the optimum is flat
AS_MUCH = 0.97  # share of the most integral action that counts as the same: of these the longest tau_I swings least


def most_integral(process: LinearProcess, ms: float) -> PidGains:
    """The controller at the head of this file.

    process : stable, with a gain at rest. ms : largest sensitivity, above 1.

    Raises ValueError: the process integrates, nothing limits its gain, or ms is not above 1.
    """
    if not 1 < ms < math.inf:
        raise ValueError(f"ms = {ms} must be more than 1 and finite; 1.59 is the usual demand")
    if process.integrators:
        raise ValueError("an integrating process has no PI controller of most integral action: give a rule for it")
    # frequencies in rad/s, and integral times in seconds
    times = [process.theta_s, *process.lags_s, *(abs(x) for x in process.leads_s)]
    times += [math.sqrt(c2) for _, c2 in process.quadratics]
    whole = sum(times)
    slow = whole - sum(x for x in process.leads_s if x > 0)  # a lead makes nothing slower
    shortest = max(min(x for x in times if x > 0), COUNTS * slow)
    low, high = math.log10(SLOWEST / whole), math.log10(FASTEST / shortest)
    w = np.logspace(low, high, int(PER_DECADE * (high - low)))
    tau_i = whole * np.geomspace(SHORTEST, LONGEST, INTEGRAL_TIMES)
    sign = math.copysign(1.0, process.k)
    z = sign * process.response(w) * (1 + 1 / (1j * w * tau_i[:, None]))
    size, least = np.abs(z) ** 2, 1 - 1 / ms**2
    root = z.real**2 - size * least
    limits = (z.real < 0) & (root >= 0)
    kc = np.where(limits, (-z.real - np.sqrt(np.maximum(root, 0.0))) / size, math.inf).min(axis=1)
    ki = kc / tau_i
    if not np.all(np.isfinite(ki)):
        raise ValueError("nothing limits the gain of this process: give more dead time")
    best = int(np.flatnonzero(ki >= AS_MUCH * ki.max())[-1])
    return PidGains(float(sign * kc[best]), float(sign * ki[best]))
