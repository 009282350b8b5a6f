"""Controller gains in parallel form, the one form in which gains are stored, interpolated and sent.

    co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv_filtered)/dt

Parallel form because interpolation of gains is then exact (the interpolated controller's output is the weighted mean
of its corners' outputs), "no integral action" is ki = 0, and nothing is ever infinite. Other forms and vendor units
are conversions at the edge: see below and vendor_units.py.

Ideal to parallel:   kp = kc,  ki = kc/tau_i,  kd = kc tau_d.
Series to parallel:  kp = kc (1 + tau_d/tau_i),  ki = kc/tau_i,  kd = kc tau_d  (tau_d/tau_i = 0 without integral).
"""

import math
from enum import StrEnum

from retuner.schedule.late_dataclass import dataclass


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

    def times(self, factor: float) -> "PidGains":
        """All gains times one factor; errors as the class."""
        return PidGains(self.kp * factor, self.ki * factor, self.kd * factor)

    @property
    def direction(self) -> int:
        """+1 for a process whose pv rises with co, -1 for a reverse-acting one."""
        return 1 if max(self.kp, self.ki, self.kd) > 0 else -1


def check_form(form: str, kc: float, tau_i_s: float | None, tau_d_s: float) -> None:
    """Refuse a gain or time that makes no controller, with one line that says what to do.

    Raises ValueError: a number is not finite, kc is 0, tau_i_s is not positive or tau_d_s is negative.
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


# ---- Forms of a PID controller and vendor units, and their conversion to and from the parallel form of gains.py.
#
#     series    c(s) = kc (1 + 1/(tau_i s)) (1 + tau_d s)           what SIMC gives
#     ideal     c(s) = kc (1 + 1/(tau_i s) + tau_d s)               "standard"; what the classic rules give
#     parallel  c(s) = kp + ki/s + kd s                             kept, interpolated and sent
#
# Series and ideal to parallel: gains.py.
# Ideal to series (Skogestad 2003, solved for the larger root):  Ti = kp/ki,  Td = kd/kp,
#     s = (1 + sqrt(1 - 4 Td/Ti))/2,   kc = kp s,  tau_i = Ti s,  tau_d = Td/s:   it exists only when Ti >= 4 Td.
# This way of writing the root has no cancellation, and PI, PD and P are no special cases of it.
#
# "No integral action" is tau_i = None and nothing else: neither 0 nor infinity stands for it. A series controller with
# tau_i < tau_d comes back with the two exchanged (kc adjusted): the same controller.

DOUBLE_ROOT_SLACK = 1e-14
"""How far 4 Td/Ti may exceed 1 and still count as the double root tau_i = tau_d (dimensionless, a few roundings)."""

SECONDS_PER_MINUTE = 60.0


class Form(StrEnum):
    """The forms under the names that the command line and the configuration use."""

    SERIES = "series"
    IDEAL = "ideal"
    PARALLEL = "parallel"


@dataclass(frozen=True, slots=True)
class SeriesGains:
    """Gains of the series (cascade, interacting) form; fields and errors as IdealGains."""

    kc: float
    tau_i_s: float | None
    tau_d_s: float = 0.0

    def __post_init__(self) -> None:
        check_form("series", self.kc, self.tau_i_s, self.tau_d_s)

    def to_parallel(self) -> PidGains:
        """The controller in parallel form."""
        return PidGains.from_series(self.kc, self.tau_i_s, self.tau_d_s)


@dataclass(frozen=True, slots=True)
class IdealGains:
    """Gains of the ideal (standard, non-interacting) form.

    kc : gain, co units per pv unit.
    tau_i_s : integral time in seconds, None for no integral action.
    tau_d_s : derivative time in seconds.

    Raises ValueError: a value is not finite, kc is 0, tau_i_s is not positive or tau_d_s is negative.
    """

    kc: float
    tau_i_s: float | None
    tau_d_s: float = 0.0

    def __post_init__(self) -> None:
        check_form("ideal", self.kc, self.tau_i_s, self.tau_d_s)

    def to_parallel(self) -> PidGains:
        """The controller in parallel form."""
        return PidGains.from_ideal(self.kc, self.tau_i_s, self.tau_d_s)


def to_ideal(gains: PidGains) -> IdealGains:
    """The ideal form of a controller.

    Parameters
    ----------
    gains : of the parallel form.

    Returns
    -------
    IdealGains

    Raises
    ------
    ValueError
        kp is 0: integral or derivative action alone exists only in parallel form.

    Examples
    --------
    >>> to_ideal(PidGains(kp=2.0, ki=0.1, kd=3.0))
    IdealGains(kc=2.0, tau_i_s=20.0, tau_d_s=1.5)
    """
    if gains.kp == 0:
        raise ValueError(f"kp = 0 (ki = {gains.ki}, kd = {gains.kd}) has no ideal or series form; use parallel")
    return IdealGains(gains.kp, gains.kp / gains.ki if gains.ki else None, gains.kd / gains.kp if gains.kd else 0.0)


LONGEST_TAU_D = 0.25


def series_kept(gains: PidGains, before: PidGains) -> PidGains:
    """Gains with a derivative time of no more than a quarter of the integral time (ideal form), or than that share was
    before: a controller in series form has no others (Skogestad 2003).
    """
    share = max(LONGEST_TAU_D, before.kd * before.ki / before.kp**2 if before.kp else 0.0)
    most = share * gains.kp**2 / gains.ki if gains.kp and gains.ki else gains.kd
    return PidGains(gains.kp, gains.ki, math.copysign(min(abs(gains.kd), abs(most)), gains.kd))


def to_series(gains: PidGains) -> SeriesGains:
    """The series form of a controller, with tau_i >= tau_d.

    Parameters
    ----------
    gains : of the parallel form.

    Returns
    -------
    SeriesGains

    Raises
    ------
    ValueError
        kp is 0, or the ideal tau_i is less than 4 tau_d: such zeros are complex, the series form has none.

    Examples
    --------
    >>> to_series(PidGains(kp=2.5, ki=0.1, kd=10.0))
    SeriesGains(kc=2.0, tau_i_s=20.0, tau_d_s=5.0)
    """
    ideal = to_ideal(gains)
    if ideal.tau_i_s is None:
        return SeriesGains(ideal.kc, None, ideal.tau_d_s)
    root = 1.0 - 4.0 * ideal.tau_d_s / ideal.tau_i_s
    if root < -DOUBLE_ROOT_SLACK:
        raise ValueError(
            f"no series form: the ideal tau_i = {ideal.tau_i_s:.6g} s is less than 4 tau_d = {4 * ideal.tau_d_s:.6g} s;"
            " use ideal or parallel"
        )
    share = (1.0 + math.sqrt(max(root, 0.0))) / 2.0
    return SeriesGains(ideal.kc * share, ideal.tau_i_s * share, ideal.tau_d_s / share)


def from_form(form: str, kc: float, tau_i_s: float | None, tau_d_s: float = 0.0) -> PidGains:
    """Parallel gains of a controller given as gain and times in a named form.

    form : "series", "ideal" or "parallel". With "parallel" the times are kp/ki and kd/kp, so its numbers are the
        ideal ones (the literature uses both names); the parallel gains themselves are the fields of PidGains.
    kc : gain in co units per pv unit. tau_i_s : integral time in seconds, None for none. tau_d_s : derivative time.

    Raises ValueError: the form is unknown or a value is outside what SeriesGains or IdealGains takes.
    """
    if _form(form) is Form.SERIES:
        return PidGains.from_series(kc, tau_i_s, tau_d_s)
    return PidGains.from_ideal(kc, tau_i_s, tau_d_s)


def in_form(gains: PidGains, form: str) -> dict[str, float | None]:
    """Gain and times of a controller in a named form: keys kc, tau_i, tau_d (seconds), tau_i None for no integral.

    A pure integral controller has kc 0, tau_i None, tau_d 0 in every form: its ki exists in parallel form only.

    Raises ValueError: the form is unknown, or the controller does not exist in it (to_series, to_ideal).
    """
    wanted = _form(form)
    if gains.kp == 0 and gains.kd == 0:
        return {"kc": 0.0, "tau_i": None, "tau_d": 0.0}
    shown = to_series(gains) if wanted is Form.SERIES else to_ideal(gains)
    return {"kc": shown.kc, "tau_i": shown.tau_i_s, "tau_d": shown.tau_d_s}


def _form(name: str) -> Form:
    try:
        return Form(name)
    except ValueError:
        raise ValueError(f"form = {name!r} is unknown; use series, ideal or parallel") from None


def proportional_band_pct(kc: float, pv_span: float, co_span: float = 100.0) -> float:
    """Proportional band in percent of the pv span: 100 co_span / (kc pv_span); it keeps the sign of kc.

    kc : gain in co units per pv unit. pv_span, co_span : spans in pv and co units.

    Raises ValueError: kc is 0, a span is not positive, a value or the band is not finite.
    """
    for label, span in (("pv_span", pv_span), ("co_span", co_span)):
        if not (span > 0 and math.isfinite(span)):
            raise ValueError(f"{label} = {span} must be a positive finite number")
    if kc == 0 or not math.isfinite(kc):
        raise ValueError(f"kc = {kc} must be a finite number other than 0")
    band = 100.0 * (co_span / pv_span) / kc
    if band == 0 or not math.isfinite(band):
        raise ValueError(f"kc = {kc} with pv_span = {pv_span}, co_span = {co_span} is beyond what numbers hold")
    return band


def repeats_per_min(tau_i_s: float | None) -> float:
    """Integral action in repeats per minute, 60 / tau_i_s; 0 for none.

    Raises ValueError: tau_i_s is not a positive finite number.
    """
    if tau_i_s is None:
        return 0.0
    if not (tau_i_s > 0 and math.isfinite(tau_i_s)):
        raise ValueError(f"tau_i_s = {tau_i_s} must be a positive finite number")
    return SECONDS_PER_MINUTE / tau_i_s
