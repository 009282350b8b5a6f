"""The slow-oscillation rule (Sigurd's): a level loop that swings slowly wants MORE gain times integral time.

    f = 0.1 (P0 / tau_I0)^2      factor by which Kc tau_I must grow for a response that just does not oscillate
    exact need 1 / zeta^2, with zeta = 0.5 sqrt(k' Kc tau_I) of the closed-loop poles of k' Kc (1 + 1/(tau_I s))/s

(Skogestad 2003 and his slides "Simple rules for PID tuning"; zeta >= 1 needs k' Kc tau_I >= 4.) For a weakly damped
swing P0 = 2 pi sqrt(tau_I/(k' Kc)), so the factor needed, 4/(k' Kc tau_I), is (P0/tau_I)^2/pi^2: 0.1 stands for 1/pi^2.
It holds only for P0 > about 3 tau_I and a sine-like, weakly damped swing; at zeta 0.05, 0.1, 0.2,
0.3, 0.5 it gives 396, 99.7, 25.7, 12.1, 5.3 for the exact 400, 100, 25, 11.1, 4. A fast oscillation (short against
tau_I) needs LESS gain.
"""

import math

FACTOR = 0.1  # the printed coefficient; 1/pi^2 = 0.1013 by derivation
SHORTEST_PERIOD = 3.0  # smallest P0/tau_I for which the rule holds: f is 0.9 there, so it asks for nothing anyway


def slow_oscillation(period_s: float, tau_i_s: float) -> float:
    """The factor f on Kc tau_I for an integrating loop that swings with this period under this integral time.

    Raises ValueError: a time is not positive and finite.
    """
    for name, value in (("period", period_s), ("tau_I", tau_i_s)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} = {value} must be positive and finite")
    return FACTOR * (period_s / tau_i_s) ** 2
