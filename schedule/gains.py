"""Controller gains in parallel form, the one form in which gains are stored, interpolated and sent.

    co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv_filtered)/dt

Parallel form because interpolation of gains is then exact (the interpolated controller's output is the weighted mean
of its corners' outputs), "no integral action" is ki = 0, and nothing is ever infinite. Other forms and vendor units
are conversions at the edge: see forms.py.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PidGains:
    """Gains of the parallel form.

    Parameters
    ----------
    kp : proportional gain, co units per pv unit.
    ki : integral gain, co units per pv unit and second.
    kd : derivative gain, co units times seconds per pv unit.

    Raises
    ------
    ValueError
        A gain is not finite, all are zero, or the signs differ: a controller acts in one direction.
    """

    kp: float
    ki: float
    kd: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("kp", self.kp), ("ki", self.ki), ("kd", self.kd)):
            if not math.isfinite(value):
                raise ValueError(f"{name} = {value} is not a finite number; give a finite gain")
            if type(value) is not float:  # of numpy, which JSON refuses in part
                object.__setattr__(self, name, float(value))
        if not (self.kp or self.ki or self.kd):
            raise ValueError("kp, ki and kd are all zero: this controller would do nothing; give at least one gain")
        if min(self.kp, self.ki, self.kd) < 0 < max(self.kp, self.ki, self.kd):
            raise ValueError(f"kp = {self.kp}, ki = {self.ki}, kd = {self.kd} have different signs; all act one way")

    @property
    def direction(self) -> int:
        """+1 for a process whose pv rises with co, -1 for a reverse-acting one."""
        return 1 if max(self.kp, self.ki, self.kd) > 0 else -1
