"""Ultimate gain and period of a process: where a proportional controller brings it to the limit of stability.

Exact: w180 is found on the closed-form phase, with the dead time in it.

Ku = 1 / |G(j w180)|,   Pu = 2 pi / w180,   w180 the crossover of phase -180 degrees with the largest |G|
"""

import math

from retuner.adaptive.crossovers import grid, phase_crossovers
from retuner.adaptive.margins import margins
from retuner.adaptive.open_loop import open_loop
from retuner.adaptive.process import LinearProcess
from retuner.schedule.gains import PidGains

JUST_BELOW = 1 - 1e-6
"""Share of Ku at which the loop must still be stable."""


def ultimate(process: LinearProcess) -> tuple[float, float]:
    """Ku in co units per pv unit (negative for a reverse-acting process) and Pu in seconds.

    Raises
    ------
    ValueError
        Proportional control never makes the process swing, or never makes it stable.
    """
    sign = math.copysign(1.0, process.k)
    loop = open_loop(process, PidGains(sign, 0.0))
    sizes = [(abs(loop.at(w)), w) for w in phase_crossovers(loop, grid(loop))]
    if not sizes:
        raise ValueError("this process has no ultimate gain: its phase never falls to -180 degrees; use another rule")
    size, w = max(sizes)
    gain = sign / size
    if not margins(process, PidGains(gain * JUST_BELOW, 0.0)).stable:
        raise ValueError("this process is not held by proportional control, so it has no ultimate gain")
    return gain, 2 * math.pi / w
