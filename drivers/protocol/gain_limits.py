"""The box that a device certifies by itself: whatever a host asks for, nothing outside it ever runs."""

import math
from dataclasses import dataclass, fields

from retuner.drivers.protocol.frames import Item, Reason
from retuner.schedule.gains import PidGains


@dataclass(frozen=True, slots=True)
class GainBox:
    """Limits of the gains that a device accepts.

    Parameters
    ----------
    kp_max, ki_max, kd_max : largest magnitudes, in the units of PidGains.
    ratio_max : largest factor, up or down, by which one write may change a gain. Generous: a change of operating region
        is one write, too; the host's guard is the narrow one.
    direction : +1 or -1 for the only sign that gains may have, 0 for either.

    Raises
    ------
    ValueError
        A limit is not positive and finite, the ratio is below 1, or the direction is none.
    """

    kp_max: float = 1e6
    ki_max: float = 1e6
    kd_max: float = 1e9
    ratio_max: float = 50.0
    direction: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value: float = getattr(self, field.name)
            if field.name != "direction" and not 0 < value < math.inf:
                raise ValueError(f"gain box: {field.name} = {value}; give a positive finite number")
        if self.ratio_max < 1:
            raise ValueError(f"gain box: ratio_max = {self.ratio_max}; give 1 or more")
        if self.direction not in {-1, 0, 1}:
            raise ValueError(f"gain box: direction = {self.direction}; give +1, -1 or 0 for either")

    def refusal(self, gains: tuple[float, float, float], running: PidGains) -> tuple[Reason, Item]:
        """Why these gains (kp, ki, kd) may not follow the running ones: (Reason, first Item at fault), or (OK, KP)."""
        old = (running.kp, running.ki, running.kd)
        limits = (self.kp_max, self.ki_max, self.kd_max)
        for item in Item:
            if not math.isfinite(gains[item]):
                return Reason.NOT_FINITE, item
            if abs(gains[item]) > limits[item] or gains[item] * self.direction < 0:
                return Reason.OUTSIDE_BOX, item
        if not any(gains) or min(gains) < 0 < max(gains):
            return Reason.OUTSIDE_BOX, Item.KP
        for item in Item:
            if self._too_far(old[item], gains[item]):
                return Reason.RATIO, item
        return Reason.OK, Item.KP

    def _too_far(self, old: float, new: float) -> bool:
        """Whether the factor between two gains is too large; switching a gain on or off is held by the box alone."""
        if not (old and new):
            return False
        return not 1 / self.ratio_max <= new / old <= self.ratio_max
