"""Gains as a person reads them on a controller: three numbers, each with its own unit, and the controller's action.

    gain        kc: output units per pv unit;  gain: percent of span per percent;  pb: proportional band, percent
    integral    s or min: integral time;  rpm: repeats per minute
    derivative  s or min (rpm too: the two go together on such controllers)

A name joins them: "kc-s", "gain-min", "pb-rpm", and "-ideal" or "-series" after it where the form is known.
"parallel" is kp, ki and kd. Conversion is vendor_units.py's, which knows the same numbers as a device keeps them.

Action as the trade says it (ISA-51.1): a reverse-acting controller lowers its output when pv rises, as heating needs
it, and has a positive kc here; a direct-acting one raises it, as cooling needs it, and has a negative kc. On most
controllers the action is a switch and the gain has no sign: with `action` given, the numbers are positive.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from retuner.schedule.forms import Form
from retuner.schedule.gains import PidGains
from retuner.schedule.vendor_units import SECONDS_PER_MINUTE, Quantity, VendorGain, VendorUnits


class Acting(StrEnum):
    """What the output does when pv rises; the value is the word of the configuration."""

    REVERSE = "reverse"
    DIRECT = "direct"

    @property
    def sign(self) -> int:
        """Sign of kc."""
        return 1 if self is Acting.REVERSE else -1

    @classmethod
    def of(cls, gains: PidGains) -> "Acting":
        """The action of a controller with these gains."""
        return cls.REVERSE if gains.direction > 0 else cls.DIRECT


class Dial(NamedTuple):
    """One number of a controller.

    key : of the configuration. quantity : what it is, see vendor_units.py. label, unit : as it is written, label first.
    scale : ours for one of the controller's. of_span : in percent of the spans of pv and output.
    """

    key: str
    quantity: Quantity
    label: str
    unit: str = ""
    scale: float = 1.0
    of_span: bool = False

    def written(self, number: float, digits: int = 3) -> str:
        """The number with its label and unit."""
        return f"{self.label} {number:.{digits}g}{self.unit}".strip()


GAINS = {
    "kc": Dial("kc", Quantity.KP, "Kc"),
    "gain": Dial("gain", Quantity.KP, "gain", " %/%", of_span=True),
    "pb": Dial("pb_pct", Quantity.XP, "PB", " %", of_span=True),
}
"""What the proportional action is dialled as, by the first part of a name."""
TIMES = {
    "s": (Dial("tau_i_s", Quantity.TN, "tau_I", " s"), Dial("tau_d_s", Quantity.TV, "tau_D", " s")),
    "min": (
        Dial("tau_i_min", Quantity.TN, "tau_I", " min", SECONDS_PER_MINUTE),
        Dial("tau_d_min", Quantity.TV, "tau_D", " min", SECONDS_PER_MINUTE),
    ),
    "rpm": (
        Dial("repeats_per_min", Quantity.REPEATS, "reset", " repeats/min"),
        Dial("tau_d_min", Quantity.TV, "tau_D", " min", SECONDS_PER_MINUTE),
    ),
}
"""What integral and derivative action are dialled as, by the second part of a name."""
PARALLEL = (Dial("kp", Quantity.KP, "kp"), Dial("ki", Quantity.KI, "ki", "/s"), Dial("kd", Quantity.KD, "kd", " s"))
KEYS = {dial.key: dial for dial in (*GAINS.values(), *(dial for pair in TIMES.values() for dial in pair))}
"""The dials by their keys in the configuration."""
DEFAULT = "kc-s"
NAMES = (*(f"{gain}-{times}" for gain in GAINS for times in TIMES), "parallel")
"""Every name without its form."""
SIGNED = {Quantity.KP, Quantity.XP, Quantity.KI, Quantity.KD}
"""Numbers that change their sign with the controller's action."""


class Dialled(NamedTuple):
    """What stands on the controller. integral : None for no integral action. form : that these numbers are of."""

    gain: float
    integral: float | None
    derivative: float
    form: Form


@dataclass(frozen=True, slots=True)
class ControllerUnits:
    """The units of one controller.

    Parameters
    ----------
    dials : of gain, integral and derivative action. form : of the numbers. pv_span, co_span : what percent of span is
        told of, pv and co units. action : None where the sign of the gain tells it.

    Raises
    ------
    ValueError
        A span is not a positive finite number.
    """

    dials: tuple[Dial, Dial, Dial] = (GAINS["kc"], *TIMES["s"])
    form: Form = Form.SERIES
    pv_span: float = 100.0
    co_span: float = 100.0
    action: Acting | None = None

    def __post_init__(self) -> None:
        for name, span in (("pv_span", self.pv_span), ("co_span", self.co_span)):
            if not 0.0 < span < math.inf:
                raise ValueError(f"{name} = {span} must be a positive finite number")

    @classmethod
    def named(
        cls, name: str, pv_span: float | None = None, co_span: float = 100.0, action: Acting | str | None = None
    ) -> "ControllerUnits":
        """The units of that name, as in "pb-rpm" or "gain-min-ideal"; series where no form is named.

        Parameters
        ----------
        name : see the head of this file. pv_span, co_span : as the class; pv_span may be left out where the name needs
            none. action : "direct" or "reverse", None where the sign of the gain tells it.

        Returns
        -------
        ControllerUnits

        Raises
        ------
        ValueError
            There is no such name or action, or pv_span is missing.

        Examples
        --------
        >>> units = ControllerUnits.named("pb-rpm", pv_span=200.0)
        >>> units.gains(50.0, 2.0)
        PidGains(kp=1.0, ki=0.03333333333333333, kd=0.0)
        >>> units.text(PidGains(kp=1.0, ki=0.05))
        'PB 50 % reset 3 repeats/min'
        """
        parts = name.split("-")
        form = Form(parts.pop()) if parts[-1] in {"series", "ideal"} else Form.SERIES
        if parts == ["parallel"]:
            dials, form = PARALLEL, Form.PARALLEL
        elif len(parts) == 2 and parts[0] in GAINS and parts[1] in TIMES:
            dials = (GAINS[parts[0]], *TIMES[parts[1]])
        else:
            raise ValueError(f"{name!r} is unknown; use {', '.join(NAMES)}, with -ideal behind it for that form")
        if pv_span is None and dials[0].of_span:
            raise ValueError(f"{name} is told of spans: give pv_span")
        if action is not None and action not in tuple(Acting):
            raise ValueError(f"action = {action!r} is unknown; use {' or '.join(Acting)}")
        return cls(
            dials, form, 100.0 if pv_span is None else pv_span, co_span, None if action is None else Acting(action)
        )

    @property
    def heads(self) -> str:
        """What `short` shows, for the head of a table: "PB in %, reset in repeats/min"."""
        shown = self.dials if self.dials == PARALLEL else self.dials[:2]
        return ", ".join(f"{dial.label} in{dial.unit}" if dial.unit else dial.label for dial in shown)

    @property
    def name(self) -> str:
        """The name that makes these units, without their form."""
        if self.dials == PARALLEL:
            return "parallel"
        gain = next(key for key, dial in GAINS.items() if dial == self.dials[0])
        return f"{gain}-{next((key for key, pair in TIMES.items() if pair[0] == self.dials[1]), 's')}"

    def gains(self, gain: float, integral: float | None = None, derivative: float = 0.0) -> PidGains:
        """The gains of a controller on which these numbers stand.

        Parameters
        ----------
        gain, integral, derivative : in these units; integral None for no integral action.

        Returns
        -------
        PidGains

        Raises
        ------
        ValueError
            A number is not finite or makes no controller, or is negative although the action is given.
        """
        values = (gain, 0.0 if integral is None else integral, derivative)
        for dial, value in zip(self.dials, values, strict=True):
            if not math.isfinite(value):
                raise ValueError(f"{dial.key} = {value} is not a finite number")
        if self.action is not None and gain < 0:
            raise ValueError(f"{self.dials[0].key} = {gain:g}: the action says the direction; give a positive number")
        if integral is not None and integral <= 0 and self.dials[1].quantity is Quantity.TN:
            raise ValueError(f"{self.dials[1].key} = {integral:g} must be positive; none at all is no integral action")
        named = {str(dial.quantity): value for dial, value in zip(self.dials, values, strict=True)}
        return self._vendor(self.form).of(named)

    def numbers(self, gains: PidGains) -> Dialled:
        """What stands on a controller with these gains, in the ideal form where there is none in its own.

        Raises
        ------
        ValueError
            There is no proportional action, which only "parallel" can say; or a number is beyond what numbers hold.
        """
        try:
            form, found = self.form, self._vendor(self.form).numbers(gains)
        except ValueError:
            form, found = Form.IDEAL, self._vendor(Form.IDEAL).numbers(gains)
        gain, integral, derivative = (found[dial.quantity] for dial in self.dials)
        return Dialled(gain, integral if gains.ki else None, derivative, form)

    def text(self, gains: PidGains, digits: int = 3, *, acting: bool = False) -> str:
        """These gains as they are written on a screen.

        acting : with the word for their action; one that the controller's switch contradicts is always told.
        """
        if gains.kp == 0 and self.dials != PARALLEL:
            return f"Ki {gains.ki:.3g}/s (integral only)" if gains.ki else f"Kd {gains.kd:.3g} s (derivative only)"
        wanted = Acting.of(gains)
        shown = (self if self.action is None else replace(self, action=wanted)).numbers(gains)
        text = " ".join(self.parts(shown, digits))
        if shown.derivative and self.dials != PARALLEL:
            text += f" ({shown.form})"
        if self.action not in {None, wanted}:
            return f"{text}, {wanted} acting (the controller is set to {self.action})"
        return f"{text}, {wanted} acting" if acting else text

    def parts(self, shown: Dialled, digits: int = 3) -> list[str]:
        """Each number with its label and unit; actions that there are not are left out."""
        gain, integral, derivative = self.dials
        found = [gain.written(shown.gain, digits)]
        found += [] if shown.integral is None else [integral.written(shown.integral, digits)]
        return found + ([derivative.written(shown.derivative, digits)] if shown.derivative else [])

    def short(self, gains: PidGains) -> str:
        """The numbers alone, for a narrow table."""
        if gains.kp == 0 and self.dials != PARALLEL:
            return self.text(gains)
        shown = self.numbers(gains)
        values = [shown.gain, *([] if shown.integral is None else [shown.integral])]
        text = ", ".join(f"{value:.3g}" for value in [*values, *([shown.derivative] if shown.derivative else [])])
        return f"{text} ({shown.form})" if shown.derivative and self.dials != PARALLEL else text

    def of_region(self, dials: tuple[Dial, Dial, Dial], form: Form) -> "ControllerUnits":
        """The same controller with other numbers on it."""
        return replace(self, dials=dials, form=form)

    def _vendor(self, form: Form) -> VendorUnits:
        """The conversion."""
        sign = 1 if self.action is None else self.action.sign
        gains = []
        for dial in self.dials:
            scale = dial.scale * (sign if dial.quantity in SIGNED else 1)
            if dial.of_span and dial.quantity is Quantity.KP:
                scale *= self.co_span / self.pv_span
            gains.append(VendorGain(dial.quantity, scale, off=0.0 if dial.quantity is Quantity.TN else None))
        return VendorUnits(tuple(gains), self.pv_span, self.co_span, series=form is Form.SERIES)
