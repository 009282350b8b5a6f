"""The forms in which people and vendors write PID settings, and their conversions to and from parallel form.

    series      co = kc (1 + 1/(tau_i s)) (1 + tau_d s) e         Skogestad's native form ("cascade", "interacting")
    ideal       co = kc (1 + 1/(tau_i s) + tau_d s) e             "standard", "ISA", "non-interacting"
    parallel    co = (kp + ki/s + kd s) e                         how gains are stored

    ideal from series    f = 1 + tau_d/tau_i,  kc' = kc f,  tau_i' = tau_i f,  tau_d' = tau_d / f
    series from ideal    exists only for tau_i' >= 4 tau_d' (Skogestad 2003, eq. 36; Astrom & Hagglund 2006, sec. 3.2)

None stands for "no integral action"; zero is never used for it.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from retuner.schedule.gains import PidGains


class Form(StrEnum):
    """A way to write PID settings."""

    SERIES = "series"
    IDEAL = "ideal"
    PARALLEL = "parallel"


def _check(form: Form, kc: float, tau_i_s: float | None, tau_d_s: float) -> None:
    """Refuse settings that no controller can have."""
    if not math.isfinite(kc) or kc == 0:
        raise ValueError(f"kc = {kc}: the {form} form needs a finite gain other than 0; give an integral-only "
                         "controller in parallel form")  # fmt: skip
    if tau_i_s is not None and not 0 < tau_i_s < math.inf:
        raise ValueError(f"tau_i = {tau_i_s} s must be positive and finite; leave it out for no integral action")
    if not 0 <= tau_d_s < math.inf:
        raise ValueError(f"tau_d = {tau_d_s} s must be zero or positive, and finite")


@dataclass(frozen=True, slots=True)
class SeriesGains:
    """Settings of the series form: gain, integral time in s (None: no integral action), derivative time in s.

    Raises
    ------
    ValueError
        kc is 0 or not finite, tau_i_s is not positive, tau_d_s is negative.
    """

    kc: float
    tau_i_s: float | None
    tau_d_s: float = 0.0

    def __post_init__(self) -> None:
        _check(Form.SERIES, self.kc, self.tau_i_s, self.tau_d_s)

    def to_parallel(self) -> PidGains:
        """The same controller in parallel form (always exists)."""
        if self.tau_i_s is None:
            return PidGains(self.kc, 0.0, self.kc * self.tau_d_s)
        return PidGains(self.kc * (1 + self.tau_d_s / self.tau_i_s), self.kc / self.tau_i_s, self.kc * self.tau_d_s)


@dataclass(frozen=True, slots=True)
class IdealGains:
    """Settings of the ideal form: gain, integral time in s (None: no integral action), derivative time in s.

    Raises
    ------
    ValueError
        kc is 0 or not finite, tau_i_s is not positive, tau_d_s is negative.
    """

    kc: float
    tau_i_s: float | None
    tau_d_s: float = 0.0

    def __post_init__(self) -> None:
        _check(Form.IDEAL, self.kc, self.tau_i_s, self.tau_d_s)

    def to_parallel(self) -> PidGains:
        """The same controller in parallel form (always exists)."""
        return PidGains(self.kc, 0.0 if self.tau_i_s is None else self.kc / self.tau_i_s, self.kc * self.tau_d_s)


def to_ideal(gains: PidGains) -> IdealGains:
    """Parallel to ideal form.

    Raises
    ------
    ValueError
        kp is 0: an integral-only controller has no ideal form.
    """
    if gains.kp == 0:
        raise ValueError("kp = 0: a controller without proportional action has no ideal form; use parallel form")
    return IdealGains(gains.kp, gains.kp / gains.ki if gains.ki else None, gains.kd / gains.kp)


def to_series(gains: PidGains) -> SeriesGains:
    """Parallel to series form.

    Raises
    ------
    ValueError
        kp is 0, or tau_i < 4 tau_d of the ideal form: the zeros are complex and no series form exists.
    """
    ideal = to_ideal(gains)
    tau_i, tau_d = ideal.tau_i_s, ideal.tau_d_s
    if tau_i is None or tau_d == 0:
        return SeriesGains(ideal.kc, tau_i, tau_d)
    under_root = 1 - 4 * tau_d / tau_i
    if under_root < -ROUNDING:
        raise ValueError(f"tau_i = {tau_i:g} s is less than 4 tau_d = {4 * tau_d:g} s: no series form exists; "
                         "use ideal or parallel form")  # fmt: skip
    share = (1 + math.sqrt(max(under_root, 0.0))) / 2
    return SeriesGains(ideal.kc * share, tau_i * share, tau_d / share)


ROUNDING = 1e-12
"""A discriminant this little below zero is rounding: equal zeros, for which the series form does exist."""


def from_form(form: str, kc: float, tau_i_s: float | None, tau_d_s: float = 0.0) -> PidGains:
    """Settings written in a named form, as parallel gains. For "parallel" the times are kp/ki and kd/kp, as for ideal.

    Raises
    ------
    ValueError
        The form is unknown, or it cannot hold these settings.
    """
    if form == Form.SERIES:
        return SeriesGains(kc, tau_i_s, tau_d_s).to_parallel()
    if form in {Form.IDEAL, Form.PARALLEL}:
        return IdealGains(kc, tau_i_s, tau_d_s).to_parallel()
    raise ValueError(f"form {form!r} is not known; give series, ideal or parallel")


def in_form(gains: PidGains, form: str) -> dict[str, float | None]:
    """Gains as {kc, tau_i, tau_d} of a named form; tau_i is None for no integral action.

    Raises
    ------
    ValueError
        The form is unknown, or the gains do not exist in it.
    """
    if form == Form.SERIES:
        found: SeriesGains | IdealGains = to_series(gains)
    elif form in {Form.IDEAL, Form.PARALLEL}:
        found = to_ideal(gains)
    else:
        raise ValueError(f"form {form!r} is not known; give series, ideal or parallel")
    return {"kc": found.kc, "tau_i": found.tau_i_s, "tau_d": found.tau_d_s}


def proportional_band(kc: float, pv_span: float, co_span: float = 100.0) -> float:
    """Proportional band in percent: the part of pv's span that moves co over its whole span, 100 co_span/(|kc| span).

    Raises
    ------
    ValueError
        kc is 0 or a span is not positive and finite.
    """
    return _band(kc, pv_span, co_span, "kc")


def gain_of_band(band_pct: float, pv_span: float, co_span: float = 100.0) -> float:
    """Gain that a proportional band in percent stands for (positive; the sign is the direction of action).

    Raises
    ------
    ValueError
        The band is 0 or a span is not positive and finite.
    """
    return _band(band_pct, pv_span, co_span, "band_pct")


def _band(value: float, pv_span: float, co_span: float, name: str) -> float:
    """The conversion, which is its own inverse."""
    if not 0 < abs(value) < math.inf:
        raise ValueError(f"{name} = {value} must be finite and not 0")
    if not (0 < pv_span < math.inf and 0 < co_span < math.inf):
        raise ValueError(f"pv_span = {pv_span}, co_span = {co_span} must be positive and finite")
    return 100.0 * co_span / (abs(value) * pv_span)


def repeats_per_minute(tau_i_s: float | None) -> float:
    """Integral action in repeats per minute, 60 / tau_i; 0 for none.

    Raises
    ------
    ValueError
        tau_i_s is not positive and finite.
    """
    if tau_i_s is None:
        return 0.0
    if not 0 < tau_i_s < math.inf:
        raise ValueError(f"tau_i = {tau_i_s} s must be positive and finite; None means no integral action")
    return 60.0 / tau_i_s


def tau_i_of_repeats(repeats: float) -> float | None:
    """Integral time in seconds of repeats per minute; None for 0 repeats.

    Raises
    ------
    ValueError
        The repeats are negative or not finite.
    """
    if not 0 <= repeats < math.inf:
        raise ValueError(f"{repeats} repeats per minute must be zero or positive, and finite")
    return 60.0 / repeats if repeats else None
