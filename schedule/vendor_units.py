"""Gains as a vendor's controller keeps them: its form, its units, its steps, and which of them it takes in one message.

    kp, ki, kd    parallel gains, in the controller's own units of output and process value
    xp            proportional band, percent of the pv span for the whole output range:  kc = 100 co_span/(xp pv_span)
    1/ki          seconds in which the integral term of parallel gains makes an error of 1 an output of 1
    tn, tv        integral and derivative time;  repeats: repeats per minute, 60/tau_I
    own number = ours / scale, then rounded to what the controller can hold

kp with tn or tv is the kc of the ideal form, or of the series form where that is said. What a controller holds after
rounding is another controller than the one that was worked out: `rounded` gives it, and only that is proved.

Where a set takes several messages, every order of them leads through other sets between; `ways` names them all.
"""

import math
from array import array
from collections.abc import Iterator, Mapping
from enum import StrEnum
from itertools import permutations
from typing import NamedTuple

from retuner.schedule import gains as forms
from retuner.schedule.gains import SECONDS_PER_MINUTE, IdealGains, PidGains, SeriesGains, proportional_band_pct
from retuner.schedule.late_dataclass import dataclass

SINGLE_MAX = 3.4028234663852886e38
END_ROUNDING = 1e-6  # Share of a step by which an end may miss the step that it is meant to be


class Quantity(StrEnum):
    """What a number of the controller is."""

    KP = "kp"
    XP = "xp"
    KI = "ki"
    KI_TIME = "1/ki"
    TN = "tn"
    REPEATS = "repeats"
    KD = "kd"
    TV = "tv"


PROPORTIONAL = (Quantity.KP, Quantity.XP)
INTEGRAL = (Quantity.KI, Quantity.TN, Quantity.REPEATS)
DERIVATIVE = (Quantity.KD, Quantity.TV)  # Numbers of devices; KI_TIME is of people's screens alone
ACTIONS = {"proportional": PROPORTIONAL, "integral": INTEGRAL, "derivative": DERIVATIVE}


@dataclass(frozen=True, slots=True)
class StorableNumbers:
    """The numbers that a place in the controller can hold.

    low, high : ends. step : between neighbours, counted from `zero`; 0 for none. single : rounded to float32.

    Raises ValueError: an end or the step is not a finite number, or the ends are the wrong way round.
    """

    low: float = -SINGLE_MAX
    high: float = SINGLE_MAX
    step: float = 0.0
    zero: float = 0.0
    single: bool = False

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.low, self.high, self.step, self.zero))) or self.step < 0:
            raise ValueError(f"{self.low} to {self.high} in steps of {self.step}: give finite numbers")
        if self.low >= self.high:
            raise ValueError(f"{self.low:g} to {self.high:g} leaves no room")

    def nearest(self, value: float) -> float:
        """The number that is kept when this one is written.

        Raises ValueError: it is not finite, or outside the range.
        """
        if not math.isfinite(value):
            raise ValueError(f"{value} is not a finite number")
        kept = self.zero + round((value - self.zero) / self.step) * self.step if self.step else value
        if self.low <= value <= self.high:
            # The step on the inner side of an end that lies between two steps, or on one but for its last digits
            for end, inward in ((self.low, self.step), (self.high, -self.step)):
                if (kept - end) * inward < 0:
                    kept = end if abs(kept - end) < END_ROUNDING * self.step else kept + inward
        if not self.low <= kept <= self.high:
            raise ValueError(f"{value:.6g} is outside {self.low:g} to {self.high:g}, what the controller can hold")
        return array("f", [kept])[0] if self.single else kept


@dataclass(frozen=True, slots=True)
class VendorGain:
    """One number of the set.

    quantity : what it is. scale : ours for one of the controller's; negative where the controller counts a
    reverse-acting gain as positive. message : number of the message that carries it; those of one message are taken at
    once. off : the number that stands for "no such action", where a time cannot say so.

    Raises ValueError: the scale is 0 or not finite.
    """

    quantity: Quantity
    scale: float = 1.0
    holds: StorableNumbers = StorableNumbers()
    message: int = 0
    off: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale):
            raise ValueError(f"{self.quantity}: scale = {self.scale}; give a finite number other than 0")


class Way(NamedTuple):
    """One order of the messages, and the sets that run between the first and the last of them."""

    messages: tuple[int, ...]
    between: tuple[PidGains, ...]


@dataclass(frozen=True, slots=True)
class VendorUnits:
    """All numbers of a set, one of each action at most.

    gains : the numbers. pv_span, co_span : spans that a proportional band is told of, in our units.
    series : kp and the times are those of the series form. by_hand : the set that runs, of a controller whose gains
    cannot be reached and are set by hand; then there are no numbers, and any set is taken as it is.

    Raises ValueError: no proportional gain, two numbers for one action, or a form that does not go with the numbers.
    """

    gains: tuple[VendorGain, ...]
    pv_span: float = 100.0
    co_span: float = 100.0
    series: bool = False
    by_hand: PidGains | None = None

    def __post_init__(self) -> None:
        if self.by_hand is not None and not self.gains:
            return
        for action, quantities in ACTIONS.items():
            found = [gain.quantity for gain in self.gains if gain.quantity in quantities]
            if len(found) > 1:
                raise ValueError(f"{' and '.join(found)} are both {action} action; give one of them")
            if not found and action == "proportional":
                raise ValueError("there is no proportional gain; give kp or xp")
        if self.series and {Quantity.KI, Quantity.KI_TIME, Quantity.KD} & {gain.quantity for gain in self.gains}:
            raise ValueError("ki and kd are of the parallel form; with form = series give tn or repeats, and tv")

    @property
    def names(self) -> tuple[str, ...]:
        """What the numbers are called, in their order."""
        return tuple(str(gain.quantity) for gain in self.gains)

    @property
    def atomic(self) -> bool:
        """Whether one message carries the whole set."""
        return len({gain.message for gain in self.gains}) == 1

    def numbers(self, gains: PidGains) -> dict[str, float]:
        """The controller's numbers for a set, by name, as it will hold them.

        Raises ValueError: it cannot hold this set: out of range, too small for its steps, an action or a form that it
        has not.
        """
        if self.by_hand is not None:
            return {}
        # refuse an action that the controller has no number for
        has = {gain.quantity for gain in self.gains}
        for value, name, quantities in (
            (gains.ki, "integral", (*INTEGRAL, Quantity.KI_TIME)),
            (gains.kd, "derivative", DERIVATIVE),
        ):
            if value and not has.intersection(quantities):
                raise ValueError(f"the controller has no number for {name} action, but this set uses it")
        # the set in the form that the controller's times are told of, where it has any
        shown = None
        if has & {Quantity.TN, Quantity.TV, Quantity.REPEATS, Quantity.XP}:
            shown = forms.to_series(gains) if self.series else forms.to_ideal(gains)
        found = {}
        for gain in self.gains:
            wanted = _wanted(gain.quantity, gains, shown, self.pv_span, self.co_span)
            try:
                found[str(gain.quantity)] = _kept(gain, wanted)
            except ValueError as error:
                raise ValueError(f"{gain.quantity}: {error}") from None
        return found

    def of(self, numbers: Mapping[str, float]) -> PidGains:
        """The set that these numbers are.

        Raises ValueError: they are no controller: not finite, a gain of 0, a time below 0.
        """
        if self.by_hand is not None:
            return self.by_hand
        kc, tau_i, tau_d = 0.0, None, 0.0
        parallel: dict[str, float] = {}
        for gain in self.gains:
            number = numbers[gain.quantity]
            value = number * gain.scale
            off = number == gain.off
            match gain.quantity:
                case Quantity.KP:
                    kc = value
                case Quantity.XP:
                    # kc of a proportional band, which is its own inverse
                    kc = proportional_band_pct(value, self.pv_span, self.co_span)
                case Quantity.TN:
                    tau_i = None if off else value
                case Quantity.REPEATS:
                    tau_i = None if value == 0 else SECONDS_PER_MINUTE / value
                case Quantity.TV:
                    tau_d = 0.0 if off else value
                case Quantity.KI_TIME:
                    parallel[Quantity.KI] = 0.0 if off else 1.0 / value
                case Quantity.KI | Quantity.KD:
                    parallel[gain.quantity] = value
        form = SeriesGains if self.series else IdealGains
        made = (
            form(kc, tau_i, tau_d).to_parallel()
            if kc
            else PidGains(0.0, parallel.get(Quantity.KI, 0.0), parallel.get(Quantity.KD, 0.0))
        )
        return PidGains(made.kp, parallel.get(Quantity.KI, made.ki), parallel.get(Quantity.KD, made.kd))

    def rounded(self, gains: PidGains) -> PidGains:
        """The set that the controller runs when it is given this one; errors as numbers."""
        return gains if self.by_hand is not None else self.of(self.numbers(gains))

    def ways(self, old: Mapping[str, float], new: Mapping[str, float]) -> Iterator[Way]:
        """Every order in which the messages that change something can be written, where each step is a controller."""
        changed = sorted({gain.message for gain in self.gains if old[gain.quantity] != new[gain.quantity]})
        for order in permutations(changed):
            now, between = dict(old), []
            try:
                for message in order[:-1]:
                    now.update(self.of_message(message, new))
                    between.append(self.of(now))
            except ValueError:
                continue
            yield Way(order, tuple(between))

    def of_message(self, message: int, numbers: Mapping[str, float]) -> dict[str, float]:
        """The numbers that one message carries."""
        return {str(gain.quantity): numbers[gain.quantity] for gain in self.gains if gain.message == message}


def _wanted(
    quantity: Quantity, gains: PidGains, shown: IdealGains | SeriesGains | None, pv_span: float, co_span: float
) -> float | None:
    """A number before scale and rounding; None for "no such action" where only `off` can say so."""
    match quantity:
        case Quantity.KP:
            return gains.kp if shown is None else shown.kc
        case Quantity.KI:
            return gains.ki
        case Quantity.KI_TIME:
            return 1.0 / gains.ki if gains.ki else None
        case Quantity.KD:
            return gains.kd
    assert shown is not None
    match quantity:
        case Quantity.XP:
            return proportional_band_pct(shown.kc, pv_span, co_span)
        case Quantity.TN:
            return shown.tau_i_s
        case Quantity.REPEATS:
            return forms.repeats_per_min(shown.tau_i_s)
    return shown.tau_d_s


def _kept(gain: VendorGain, wanted: float | None) -> float:
    if wanted is None or (wanted == 0 and gain.off is not None):
        if gain.off is None:
            raise ValueError("the set has no integral action, and the controller has no number for that; give `off`")
        return gain.off
    number = gain.holds.nearest(wanted / gain.scale)
    if number == 0 and wanted and gain.quantity not in DERIVATIVE:
        raise ValueError(f"{wanted / gain.scale:.6g} would be rounded to 0, in steps of {gain.holds.step:g}")
    if gain.quantity is Quantity.TN and number == gain.off:
        raise ValueError(f"{wanted / gain.scale:.6g} would be rounded to {number:g}, which stands for no action")
    return number
