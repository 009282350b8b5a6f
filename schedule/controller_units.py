"""Gains as a person reads them on a controller: three numbers, each with its own unit, and the controller's action.

    gain        kc: output units per pv unit;  gain: percent of span per percent;  pb: proportional band, percent
    integral    s or min: integral time;  rpm: repeats per minute
    derivative  s or min (rpm too: the two go together on such controllers)

A name joins them: "kc-s", "gain-min", "pb-rpm", and "-ideal" or "-series" after it where the form is known.
"parallel" is kp, ki and kd. A vendor's controller has a name of its own, "deltav-standard" (dials.py). Conversion is
vendor_units.py's, which knows the same numbers as a device keeps them.

Action as the trade says it (ISA-51.1): a reverse-acting controller lowers its output when pv rises, as heating needs
it, and has a positive kc here; a direct-acting one raises it, as cooling needs it, and has a negative kc. On most
controllers the action is a switch and the gain has no sign: with `action` given, the numbers are positive.
"""

import math
from enum import StrEnum
from typing import NamedTuple

from retuner.schedule.dials import CONTROLLERS, GAINS, NO_DERIVATIVE, PARALLEL, TIMES, Dial, told_of_spans
from retuner.schedule.gains import Form, PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.vendor_units import Quantity, VendorGain, VendorUnits


class Acting(StrEnum):
    """What the output does when pv rises.

    Attributes
    ----------
    REVERSE : it falls, as in heating; kc is positive. DIRECT : it rises, as in cooling; kc is negative.
    """

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


DEFAULT = "kc-s"
NAMES = (*(f"{gain}-{times}" for gain in GAINS for times in TIMES), "parallel")  # Every name of units without its form
SIGNED = {Quantity.KP, Quantity.XP, Quantity.KI, Quantity.KI_TIME, Quantity.KD}
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
        told of, pv and co units. action : None where the sign of the gain tells it. controller : the vendor's, as in
        dials.py; empty for units that are nobody's.

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
    controller: str = ""

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
        name : see the head of this file; of controllers also in capitals or with "_". pv_span, co_span : as the class;
            pv_span may be left out where the name needs none. action : "direct" or "reverse", None where the sign
            of the gain tells it.

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
        vendor = name.lower().replace("_", "-")
        if vendor in CONTROLLERS:
            dials, form = CONTROLLERS[vendor]
        else:
            vendor = ""
            dials, form = _of_units(name)
        if pv_span is None and told_of_spans(name):
            raise ValueError(f"{name} counts in percent of spans: give pv_span")
        if action is not None and action not in tuple(Acting):
            raise ValueError(f"action = {action!r} is unknown; use {' or '.join(Acting)}")
        acting = None if action is None else Acting(action)
        return cls(dials, form, 100.0 if pv_span is None else pv_span, co_span, acting, vendor)

    @property
    def apart(self) -> bool:
        """Whether integral and derivative action have gains of their own: then there may be no proportional one."""
        return self.dials[1].quantity in {Quantity.KI, Quantity.KI_TIME}

    @property
    def heads(self) -> str:
        """What `short` shows, for the head of a table: "PB in %, reset in repeats/min"."""
        shown = [dial for dial in self.dials if dial.label] if self.apart else self.dials[:2]
        return ", ".join(f"{dial.label} in{dial.unit}" if dial.unit else dial.label for dial in shown)

    @property
    def name(self) -> str:
        """The name that makes these units, without their form where they are no vendor's."""
        if self.controller:
            return self.controller
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
            raise ValueError(f"{self.dials[0].key} = {gain:g}: with an action, give a positive number")
        if derivative and self.dials[2] == NO_DERIVATIVE:
            raise ValueError(f"{self.controller} has no derivative action: leave {derivative:g} out")
        if integral is not None and integral <= 0 and self.dials[1].quantity in {Quantity.TN, Quantity.KI_TIME}:
            raise ValueError(f"{self.dials[1].key} = {integral:g} must be positive; leave it out for none")
        named = {str(dial.quantity): value for dial, value in zip(self.dials, values, strict=True)}
        return self._vendor(self.form).of(named)

    def numbers(self, gains: PidGains) -> Dialled:
        """What stands on a controller with these gains, in the ideal form where there is none in its own.

        Raises
        ------
        ValueError
            There is no proportional action, which only "parallel" can say; or a number is beyond what numbers hold.
        """
        if gains.kd and self.dials[2] == NO_DERIVATIVE:
            raise ValueError(f"{self.controller} has no derivative action, but these gains do; use kind pi")
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
        if gains.kp == 0 and not self.apart:
            return f"Ki {gains.ki:.3g}/s (integral only)" if gains.ki else f"Kd {gains.kd:.3g} s (derivative only)"
        wanted = Acting.of(gains)
        if gains.kd and self.dials[2] == NO_DERIVATIVE:
            return (
                f"{self.text(replace(gains, kd=0.0), digits, acting=acting)} and kd {gains.kd:.3g} s, which it has not"
            )
        shown = (self if self.action is None else replace(self, action=wanted)).numbers(gains)
        text = " ".join(self.parts(shown, digits))
        if shown.derivative and not self.apart and (shown.form != self.form or not self.controller):
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
        if (gains.kp == 0 and not self.apart) or (gains.kd and self.dials[2] == NO_DERIVATIVE):
            return self.text(gains)
        shown = self.numbers(gains)
        values = [shown.gain, *([] if shown.integral is None else [shown.integral])]
        text = ", ".join(f"{value:.3g}" for value in [*values, *([shown.derivative] if shown.derivative else [])])
        return f"{text} ({shown.form})" if shown.derivative and not self.apart else text

    def of_region(self, dials: tuple[Dial, Dial, Dial], form: Form) -> "ControllerUnits":
        """The controller with other numbers on it."""
        return replace(self, dials=dials, form=form, controller="")

    def _vendor(self, form: Form) -> VendorUnits:
        sign = 1 if self.action is None else self.action.sign
        gains = []
        for dial in self.dials:
            scale = dial.scale * (sign if dial.quantity in SIGNED else 1)
            if dial.of_span and dial.quantity is not Quantity.XP:
                ratio = self.co_span / self.pv_span
                scale *= 1.0 / ratio if dial.quantity is Quantity.KI_TIME else ratio
            time = dial.quantity in {Quantity.TN, Quantity.KI_TIME}
            gains.append(VendorGain(dial.quantity, scale, off=0.0 if time else None))
        return VendorUnits(tuple(gains), self.pv_span, self.co_span, series=form is Form.SERIES)


def _of_units(name: str) -> tuple[tuple[Dial, Dial, Dial], Form]:
    """Dials and form of a name that is no vendor's. Raises ValueError: there is no such name."""
    parts = name.split("-")
    form = Form(parts.pop()) if parts[-1] in {"series", "ideal"} else Form.SERIES
    if parts == ["parallel"]:
        return PARALLEL, Form.PARALLEL
    if len(parts) == 2 and parts[0] in GAINS and parts[1] in TIMES:
        return (GAINS[parts[0]], *TIMES[parts[1]]), form
    named = f"{', '.join(NAMES)}, with -ideal behind it for that form, or a controller: {', '.join(CONTROLLERS)}"
    raise ValueError(f"{name!r} is unknown; use {named}")
