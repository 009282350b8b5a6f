"""A process whose gain, lags and dead time depend on where it is, or change with time.

    tau1 dy/dt = k (x - u_rest(y)),   tau2 dx/dt = u(t - theta) - x          integrating: dy/dt = k x

k, tau1, tau2, theta are read once a sample. Within a sample it moves in SUBSTEPS steps, y and x exactly for what they
are given then; the dead time is rounded to a substep. With constant parameters and tau2 = 0 that is the exact held
response.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from retuner.adaptive.process.model import LinearProcess

SUBSTEPS = 4
MOST_DELAY = 4096  # Substeps of dead time that are remembered


@dataclass(frozen=True, slots=True)
class Local:
    """The process at one place and time: its linearisation. integrating : k is the slope gain, tau1_s is not used."""

    k: float
    tau1_s: float
    tau2_s: float
    theta_s: float
    integrating: bool = False

    def linear(self) -> LinearProcess:
        """As a general linear process."""
        if self.integrating:
            return LinearProcess(self.k, _lags(self.tau2_s), (), self.theta_s, 1)
        return LinearProcess(self.k, _lags(self.tau1_s, self.tau2_s), (), self.theta_s)


class VaryingPlant:
    """See the head of this file; about the resting point (y0, u0).

    at : the process at y. rest : the input that holds y (not for integrating processes, where it is 0).
    """

    def __init__(
        self, at: Callable[[float], Local], rest: Callable[[float], float], h_s: float, y0: float = 0.0
    ) -> None:
        self.at, self.rest = at, rest
        self._h_s = h_s / SUBSTEPS
        self._y0 = self._y = y0
        self._integrating = at(y0).integrating
        self._x = self._u0 = 0.0 if self._integrating else rest(y0)
        self._past = [self._u0] * MOST_DELAY
        self._i = 0

    def move(self, u: float) -> float:
        """Hold the input u0 + u for a sample; y - y0 at its end."""
        local, h, past, i = self.at(self._y), self._h_s, self._past, self._i
        u += self._u0
        late = min(round(local.theta_s / h), MOST_DELAY - 1)
        decay = 1 - math.exp(-h / local.tau1_s) if local.tau1_s else 1.0
        follow = 1 - math.exp(-h / local.tau2_s) if local.tau2_s else 1.0
        x, y, k = self._x, self._y, local.k
        for _ in range(SUBSTEPS):
            past[i % MOST_DELAY] = u
            before = x
            x += follow * (past[(i - late) % MOST_DELAY] - x)
            middle = (before + x) / 2 if local.tau2_s else x
            y += h * k * middle if local.integrating else decay * k * (middle - self.rest(y))
            i += 1
        self._x, self._y, self._i = x, y, i
        return y - self._y0


class Changing:
    """A linear process that may be another from now on: `now` is set from outside. Rest is at zero."""

    def __init__(self, now: Local) -> None:
        self.now = now

    def at(self, y: float) -> Local:  # noqa: ARG002  the same everywhere
        """What it is now."""
        return self.now

    def rest(self, y: float) -> float:
        """The input that holds y."""
        return y / self.now.k


def _lags(*lags: float) -> tuple[float, ...]:
    return tuple(lag for lag in lags if lag > 0)
