"""Signals recorded as they came: 4 to 20 mA, 0 to 10 V or raw counts, scaled to the unit of the plant.

    "4..20:0..200"      what is recorded, and what it stands for;  "mA:0..200" says the same

The line goes on beyond both ends: 3.8 mA is a little below the range, and not the end of it.
"""

import re
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from retuner.drivers.historian.assumption import Assumption
from retuner.drivers.recorded.recording import Recording
from retuner.schedule.late_dataclass import dataclass, replace

NUMBER = r"\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*"
FORM = re.compile(rf"{NUMBER}\.\.{NUMBER}:{NUMBER}\.\.{NUMBER}")
NAMED = {"mA": "4..20", "V": "0..10"}  # Ranges that have a name
SHAPE = 'give "4..20:0..200", what is recorded and what it stands for, or "mA:0..200"'
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scaling:
    """A straight line from what is recorded to what it stands for.

    raw_low, raw_high : ends of what is recorded, different. low, high : what they stand for, different.

    Raises ValueError: an end is not finite, or two of them are the same.

    Examples
    --------
    >>> Scaling.of("mA:0..200").applied(12.0)
    100.0
    """

    raw_low: float
    raw_high: float
    low: float
    high: float

    def __post_init__(self) -> None:
        ends = (self.raw_low, self.raw_high, self.low, self.high)
        if not np.all(np.isfinite(ends)):
            raise ValueError(f"{ends}: give finite numbers")
        if self.raw_low == self.raw_high or self.low == self.high:
            raise ValueError(f"{self.text()}: the two ends are equal; give a range")

    @classmethod
    def of(cls, text: str) -> "Scaling":
        """The scaling that a text says. Raises ValueError: it is none, see SHAPE."""
        raw, colon, meant = text.partition(":")
        found = FORM.fullmatch(f"{NAMED.get(raw.strip(), raw)}{colon}{meant}")
        if found is None:
            raise ValueError(f"{text!r}: {SHAPE}")
        return cls(*map(float, found.groups()))

    def applied(self, raw: float) -> float:
        """What a recorded value stands for."""
        return self.low + (raw - self.raw_low) * (self.high - self.low) / (self.raw_high - self.raw_low)

    def of_all(self, raw: FloatArray) -> FloatArray:
        """What recorded values stand for."""
        return self.low + (raw - self.raw_low) * ((self.high - self.low) / (self.raw_high - self.raw_low))

    def covers(self, raw: FloatArray) -> bool:
        """Whether all values lie in what can be recorded."""
        least, most = sorted((self.raw_low, self.raw_high))
        return bool(np.all((raw >= least) & (raw <= most)))

    def text(self) -> str:
        """The scaling as it is written."""
        return f"{self.raw_low:.15g}..{self.raw_high:.15g}:{self.low:.15g}..{self.high:.15g}"


def scaled(recording: Recording, scale: Mapping[str, str]) -> tuple[Recording, tuple[Assumption, ...]]:
    """A record in the units of the plant, and what was assumed of the setpoint.

    scale : by signal, "pv", "sp" or "co". A setpoint without its own is taken to be recorded like pv where it lies in
    that range, and to be in pv's unit already where it does not.
    """
    if not scale:
        return recording, ()
    known = {role: Scaling.of(text) for role, text in scale.items()}
    told: tuple[Assumption, ...] = ()
    if "pv" in known and "sp" not in known and recording.sp is not None:
        if known["pv"].covers(recording.sp):
            known["sp"], what = known["pv"], "sp is recorded like pv, and scaled like it"
        else:
            what = "sp is in the unit of pv already, not recorded like it"
        told = (Assumption(what, f'scale = {{ sp = "{known["pv"].text()}" }}'),)

    def meant(role: str, raw: FloatArray) -> FloatArray:
        return known[role].of_all(raw) if role in known else raw

    sp = None if recording.sp is None else meant("sp", recording.sp)
    return replace(recording, pv=meant("pv", recording.pv), co=meant("co", recording.co), sp=sp), told
