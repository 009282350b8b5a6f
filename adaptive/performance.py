"""Performance of a loop: integrated absolute error and total variation of the output, for steps of setpoint and load.

    IAE = integral |r - y| dt,   TV = integral |du/dt| dt (jumps included),   J = 0.5 (IAE_ys/IAE_ys* + IAE_d/IAE_d*)

(Grimholt & Skogestad 2012, equations 5 and 6; IAE* belongs to the best PI controllers at Ms = 1.59, see optimum.py.)
The response is exact: collocation over each dead time (delay_steps.py), the matrix exponential without one
(plain_steps.py). As the error's integral z is a state, IAE is the total variation of z: the sum of |z| from one zero of
the error to the next. z stands still at these zeros, so they need not be known well for many digits of IAE.

The steps are of size 1, at the setpoint and at the process input; IAE of the load scales with the process gain.
With a derivative the setpoint's step makes an impulse in u (TV is infinite then): the literature's convention, where a
step of the setpoint is one of an output disturbance. derivative_on_setpoint=False is what controllers mostly do.
"""

import math
from dataclasses import dataclass, replace

from retuner.adaptive.crossovers import gain_crossovers, grid
from retuner.adaptive.open_loop import OpenLoop, open_loop
from retuner.adaptive.process import LinearProcess
from retuner.adaptive.stability import is_stable
from retuner.adaptive.variation import Variation, variation
from retuner.schedule.gains import PidGains


@dataclass(frozen=True, slots=True)
class Performance:
    """What unit steps cost; infinite where the error never dies out, or where the loop is unstable.

    iae_setpoint : pv units times seconds per pv unit. iae_load : pv units times seconds per co unit at the input.
    tv_setpoint, tv_load : total variation of co per unit of the step.
    """

    iae_setpoint: float
    iae_load: float
    tv_setpoint: float
    tv_load: float

    def to_dict(self) -> dict[str, float | None]:
        """Keys iae_setpoint, iae_load, tv_setpoint, tv_load; null where infinite."""
        names = ("iae_setpoint", "iae_load", "tv_setpoint", "tv_load")
        return {name: value if math.isfinite(value := getattr(self, name)) else None for name in names}


NEVER = Variation(math.inf, math.inf)
NEEDLESS_DELAY = 1e-5
"""Dead time over the inverse of the highest gain crossover below which it counts as a lag."""


def performance(
    process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0, *, derivative_on_setpoint: bool = True
) -> Performance:
    """IAE and TV of both steps.

    tau_f_s : filter time of the derivative in seconds.

    Raises
    ------
    ValueError
        The process has more zeros than poles, or as many and the derivative has no filter.
    """
    loop = open_loop(process, gains, tau_f_s)
    crossed = gain_crossovers(loop, grid(loop))
    if not is_stable(loop, crossed):
        return Performance(math.inf, math.inf, math.inf, math.inf)
    process = _without_needless_delay(process, loop, crossed)
    setpoint = setpoint_variation(process, gains, tau_f_s, derivative_on_setpoint=derivative_on_setpoint)
    load = load_variation(process, gains, tau_f_s)
    return Performance(setpoint.error, load.error, setpoint.output, load.output)


def setpoint_variation(
    process: LinearProcess,
    gains: PidGains,
    tau_f_s: float = 0.0,
    *,
    derivative_on_setpoint: bool = True,
    with_output: bool = True,
) -> Variation:
    """IAE and TV of a unit setpoint step of a loop that is known to be stable; without TV it is faster."""
    if process.integrators + (1 if gains.ki else 0) == 0 or not (gains.kp or gains.ki):
        return NEVER  # an offset remains
    return variation(process, gains, tau_f_s, 1.0, 0.0, kick=derivative_on_setpoint, with_output=with_output)


def load_variation(
    process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0, *, with_output: bool = True
) -> Variation:
    """IAE and TV of a unit load step at the process input of a loop that is known to be stable."""
    if not gains.ki:
        return NEVER
    return variation(process, gains, tau_f_s, 0.0, 1.0, kick=False, with_output=with_output)


def _without_needless_delay(process: LinearProcess, loop: OpenLoop, crossed: list[float]) -> LinearProcess:
    """A dead time far shorter than all that the loop does becomes a lag: they differ by (w theta)^2 where L matters."""
    if not process.theta_s or loop.excess < 1 or process.theta_s * max(crossed, default=0.0) > NEEDLESS_DELAY:
        return process
    return replace(process, theta_s=0.0, lags_s=(*process.lags_s, process.theta_s))


def weighted_cost(found: Performance, best_setpoint: float, best_load: float) -> float:
    """J of these numbers against the reference values IAE_ys*, IAE_d*.

    Raises
    ------
    ValueError
        A reference is not positive and finite.
    """
    for value in (best_setpoint, best_load):
        if not 0 < value < math.inf:
            raise ValueError(f"reference IAE = {value} must be positive and finite")
    return 0.5 * (found.iae_setpoint / best_setpoint + found.iae_load / best_load)
