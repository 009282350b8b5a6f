"""Controller gains in parallel form, the one form in which gains are stored, interpolated and sent.

    co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv_filtered)/dt

Parallel form because interpolation of gains is then exact (the interpolated controller's output is the weighted mean
of its corners' outputs), "no integral action" is ki = 0, and nothing is ever infinite. Other forms and vendor units
are conversions at the edge: see forms.py and vendor_units.py.

Ideal to parallel:   kp = kc,  ki = kc/tau_i,  kd = kc tau_d.
Series to parallel:  kp = kc (1 + tau_d/tau_i),  ki = kc/tau_i,  kd = kc tau_d  (tau_d/tau_i = 0 without integral).
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

    Examples
    --------
    >>> PidGains(kp=2.0, ki=0.1)
    PidGains(kp=2.0, ki=0.1, kd=0.0)
    >>> PidGains.from_ideal(kc=2.0, tau_i_s=20.0)
    PidGains(kp=2.0, ki=0.1, kd=0.0)
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
            raise ValueError(f"kp = {self.kp}, ki = {self.ki}, kd = {self.kd} have different signs; use one sign")

    def __str__(self) -> str:
        """The gains to three digits, without those that are zero, as in "kp 2, ki 0.1"."""
        named = {"kp": self.kp, "ki": self.ki, "kd": self.kd}
        return ", ".join(f"{name} {value:.3g}" for name, value in named.items() if value)

    @classmethod
    def from_parallel(cls, kp: float, ki: float = 0.0, kd: float = 0.0) -> "PidGains":
        """The gains of the parallel form, as they are: what simple-pid calls Kp, Ki and Kd.

        Raises
        ------
        ValueError
            As the class.

        Examples
        --------
        >>> PidGains.from_parallel(1.0, 0.1, 0.05)
        PidGains(kp=1.0, ki=0.1, kd=0.05)
        """
        return cls(kp, ki, kd)

    @classmethod
    def from_ideal(cls, kc: float, tau_i_s: float | None = None, tau_d_s: float = 0.0) -> "PidGains":
        """The gains of a controller in ideal (standard, ISA) form: kc (1 + 1/(tau_i s) + tau_d s).

        Parameters
        ----------
        kc : gain, co units per pv unit; negative for a direct-acting controller. tau_i_s : integral time in seconds,
            None for no integral action. tau_d_s : derivative time in seconds.

        Returns
        -------
        PidGains

        Raises
        ------
        ValueError
            A number is not finite, kc is 0, tau_i_s is not positive or tau_d_s is negative.

        Examples
        --------
        >>> PidGains.from_ideal(2.0, 20.0, 1.5)
        PidGains(kp=2.0, ki=0.1, kd=3.0)
        """
        check_form("ideal", kc, tau_i_s, tau_d_s)
        return cls(kc, _integral_gain("ideal", kc, tau_i_s), kc * tau_d_s + 0.0)  # not -0.0

    @classmethod
    def from_series(cls, kc: float, tau_i_s: float | None = None, tau_d_s: float = 0.0) -> "PidGains":
        """The gains of a controller in series (interacting) form: kc (1 + 1/(tau_i s)) (1 + tau_d s).

        Parameters
        ----------
        kc, tau_i_s, tau_d_s : as for `from_ideal`, of the series form.

        Returns
        -------
        PidGains

        Raises
        ------
        ValueError
            As `from_ideal`.

        Examples
        --------
        >>> PidGains.from_series(2.0, 20.0, 5.0)
        PidGains(kp=2.5, ki=0.1, kd=10.0)
        """
        check_form("series", kc, tau_i_s, tau_d_s)
        ratio = 0.0 if tau_i_s is None else tau_d_s / tau_i_s
        return cls(kc * (1.0 + ratio), _integral_gain("series", kc, tau_i_s), kc * tau_d_s + 0.0)

    @property
    def direction(self) -> int:
        """+1 for a process whose pv rises with co, -1 for a reverse-acting one."""
        return 1 if max(self.kp, self.ki, self.kd) > 0 else -1


def check_form(form: str, kc: float, tau_i_s: float | None, tau_d_s: float) -> None:
    """Refuse a gain or time that makes no controller, with one line that says what to do.

    Raises
    ------
    ValueError
        A number is not finite, kc is 0, tau_i_s is not positive or tau_d_s is negative.
    """
    for name, value in (("kc", kc), ("tau_i_s", tau_i_s), ("tau_d_s", tau_d_s)):
        if value is not None and not math.isfinite(value):
            raise ValueError(f"{form} form: {name} = {value} is not a finite number (no integral action is tau_i null)")
    if kc == 0:
        raise ValueError(f"{form} form: kc = 0 does nothing; give a pure integral controller in parallel form (ki)")
    if tau_i_s is not None and tau_i_s <= 0:
        raise ValueError(f"{form} form: tau_i_s = {tau_i_s} must be positive; leave it out for no integral action")
    if tau_d_s < 0:
        raise ValueError(f"{form} form: tau_d_s = {tau_d_s} must not be negative")


def _integral_gain(form: str, kc: float, tau_i_s: float | None) -> float:
    """kc / tau_i in co units per pv unit and second; refused when it rounds to none at all."""
    if tau_i_s is None:
        return 0.0
    ki = kc / tau_i_s
    if ki == 0:
        raise ValueError(f"{form} form: kc / tau_i_s = {kc} / {tau_i_s} rounds to 0; leave tau_i_s out")
    return ki
