"""Processes drawn from families of the literature and from some that no published batch has.

All are drawn with an effective dead time of about one, then put on a time scale over four decades, in units over five
decades and with a gain of either sign.
"""

import math

import numpy as np

from retuner.adaptive.process.model import LinearProcess

DECADES_OF_TIME = (-2.0, 2.0)
"""Exponents of ten of the time scale in seconds: from an effective dead time of 10 ms to 100 s."""
DECADES_OF_GAIN = (-2.0, 3.0)
"""Exponents of ten of pv units per co unit."""
FAMILIES = (
    "first",
    "second",
    "oscillatory",
    "integrating",
    "integrating-lag",
    "equal-lags",
    "lag-series",
    "inverse",
    "batch-p3",
    "batch-p5",
    "batch-p6",
    "batch-p7",
    "batch-p9",
    "diffusion",
    "integrating-lags",
    "two-lags-inverse",
)
INTEGRATING = frozenset({"integrating", "integrating-lag", "batch-p6", "integrating-lags"})

Shape = tuple[tuple[float, ...], tuple[float, ...], tuple[tuple[float, float], ...], float, int]
"""lags, leads, quadratics, dead time, integrators"""


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Between low and high, every factor equally likely."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def draw(rng: np.random.Generator, family: str) -> LinearProcess:
    """One process of a family, with its time scale, units and sign drawn too."""
    # Time constants with an effective dead time of the order of one
    simple = {
        "first": lambda: ((log_uniform(rng, 0.3, 50.0),), (), (), 1.0, 0),
        "second": lambda: (_two_lags(rng), (), (), 1.0, 0),
        "oscillatory": lambda: ((), (), (_pair(rng, log_uniform(rng, 0.5, 6.0), 0.4),), 1.0, 0),
        "integrating": lambda: ((), (), (), 1.0, 1),
        "integrating-lag": lambda: ((log_uniform(rng, 0.1, 5.0),), (), (), 1.0, 1),
        "equal-lags": lambda: ((1.0,) * int(rng.integers(3, 9)), (), (), 0.0, 0),
        "lag-series": lambda: (tuple(log_uniform(rng, 0.1, 5.0) for _ in range(rng.integers(3, 7))), (), (), 0.2, 0),
        "inverse": lambda: ((1.0, 1.0, 1.0), (-float(rng.uniform(0.1, 1.1)),), (), 0.0, 0),
    }
    lags, leads, quadratics, theta, integrators = simple[family]() if family in simple else _more(rng, family)
    scale = 10 ** rng.uniform(*DECADES_OF_TIME)
    k = float(rng.choice([-1.0, 1.0])) * 10 ** rng.uniform(*DECADES_OF_GAIN) / scale**integrators
    return LinearProcess(
        k,
        tuple(x * scale for x in lags),
        tuple(x * scale for x in leads),
        theta * scale,
        integrators,
        tuple((c1 * scale, c2 * scale**2) for c1, c2 in quadratics),
    )


def _more(rng: np.random.Generator, family: str) -> Shape:
    """Families of the Astrom-Hagglund batch with parameters drawn anew, and others beyond it."""
    a, t = float(rng.uniform(0.1, 0.9)), log_uniform(rng, 1.0, 10.0)
    length = float(rng.uniform(0.05, 0.95))
    quick = log_uniform(rng, 0.3, 3.0)
    far = {
        "batch-p3": lambda: ((1.0, *(log_uniform(rng, 0.02, 10.0),) * 2), (), (), 0.0, 0),
        "batch-p5": lambda: (tuple(a**i for i in range(4)), (), (), 0.0, 0),
        "batch-p6": lambda: ((1 - length,), (), (), length, 1),
        "batch-p7": lambda: ((t, 1 - length), (), (), length, 0),
        "batch-p9": lambda: ((1.0,), (), (_pair(rng, float(rng.uniform(0.1, 1.0)), 0.7, 0.7),), 0.0, 0),
        "diffusion": lambda: (tuple(8.0 / (2 * i - 1) ** 2 for i in range(1, 7)), (), (), float(rng.uniform(0, 1)), 0),
        "integrating-lags": lambda: (tuple(log_uniform(rng, 0.1, 2.0) for _ in range(3)), (), (), 0.3, 1),
        "two-lags-inverse": lambda: ((4.0 * quick, quick), (-float(rng.uniform(0.1, 0.8)) * quick,), (), 0.5, 0),
    }
    return far[family]()


def _two_lags(rng: np.random.Generator) -> tuple[float, float]:
    tau1 = log_uniform(rng, 0.6, 30.0)
    return tau1, tau1 * log_uniform(rng, 0.1, 1.0)


def _pair(rng: np.random.Generator, t: float, low: float, high: float = 1.0) -> tuple[float, float]:
    """c1, c2 of a pair of poles with the natural period 2 pi t and a damping between low and high."""
    return 2 * float(rng.uniform(low, high)) * t, t * t
