"""What the guard is asked: one change of the gains of one region, and everything that the answer depends on."""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import Tuning
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.vendor_units import VendorUnits


class Support(StrEnum):
    """What a proposal rests on."""

    MODEL = "model"
    PATTERN = "pattern"


@dataclass(frozen=True, slots=True)
class Evidence:
    """How much stands behind the models.

    records : behind the region's model. age_s : of the last one. innovation, gate : how far the last record lay from
    what was known, and the limit. borrowed : the model comes from a neighbouring region. support : model
    or pattern. settled : whether settings may follow from what is known of the process.

    Raises ValueError: a number is negative or not a number.
    """

    records: int = 1
    age_s: float = 0.0
    innovation: float = 0.0
    gate: float = math.inf
    borrowed: bool = False
    support: Support = Support.MODEL
    settled: bool = True

    def __post_init__(self) -> None:
        for name in ("records", "age_s", "innovation", "gate"):
            value: float = getattr(self, name)
            if not value >= 0:
                raise ValueError(f"evidence: {name} = {value} must be a number, 0 or more")


@dataclass(frozen=True, slots=True)
class Locks:
    """Parameters that stay as they are in force. tau_d also says: no derivative where there is none."""

    kc: bool = False
    tau_i: bool = False
    tau_d: bool = False

    def keep(self, wanted: PidGains, in_force: PidGains) -> PidGains:
        """The wanted gains with locked parameters of the ideal form (Kc, tau_I, tau_D) as they are in force.

        Where one of the two sets has no proportional gain its times do not exist: a locked Kc or tau_I then keeps the
        whole set, a locked tau_D only the derivative.
        """
        if not (self.kc or self.tau_i or self.tau_d):
            return wanted
        if not (wanted.kp and in_force.kp):
            return in_force if self.kc or self.tau_i else PidGains(wanted.kp, wanted.ki, in_force.kd)
        kc = in_force.kp if self.kc else wanted.kp
        integral = in_force if self.tau_i else wanted
        derivative = in_force if self.tau_d else wanted
        return PidGains(kc, kc * (integral.ki / integral.kp), kc * (derivative.kd / derivative.kp))


NO_LOCKS = Locks()
NO_DERIVATIVE = Locks(tau_d=True)
KC_ONLY = Locks(tau_i=True, tau_d=True)


class DiagonalNeighbour(NamedTuple):
    """A cell between this one and the one diagonally opposite. gains : its set. model : its best, None if unknown."""

    gains: PidGains
    model: ProcessModel | None


@dataclass(frozen=True, slots=True)
class NeighbourBoundary:
    """A neighbouring region, as far as the changed gains reach into it.

    name : of the neighbour. gains : its set. models : of its process, best first, empty where not known.
    reach : largest weight of the neighbour's process (0 own centre, 1 its centre) at which the gains still take part.
    interpolated : the gains are mixed with the neighbour's by that weight; otherwise they run alone up to it.
    cells_between : on a map of two axes, for a neighbour that meets this region in a corner only; the weight is then
        that along both axes.

    Raises ValueError: reach is outside 0 to 1.
    """

    name: str
    gains: PidGains
    models: tuple[Plausible, ...]
    reach: float
    interpolated: bool = False
    cells_between: tuple[DiagonalNeighbour, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.reach <= 1:
            raise ValueError(f"boundary to {self.name!r}: reach = {self.reach} is outside 0 to 1")


@dataclass(frozen=True, slots=True)
class ChangeRequest:
    """One change to be proved.

    in_force : gains running now. commissioned : the region's gains as commissioned.
    proposal : what a rule wants; without tau_c there is no slower version of it to try.
    models : what the records still allow, best first (model_set.py); may be empty for a proposal by the pattern.
    sample_time_s : of the controller; half of it counts as dead time.
    slower : the rule's own settings at larger tau_c, in order of tau_c; the guard finds SIMC's by itself.
    filter_s : filter time of the controller's derivative, s.
    urgent : a measured oscillation that does not decay. locks : parameters that must stay.
    units : how the controller keeps gains: only what it can hold is proved. None for one that keeps them as they are.

    Raises ValueError: the sampling time is not positive and finite, an excess is negative or not finite, or the first
    model is not the best one.
    """

    in_force: PidGains
    commissioned: PidGains
    proposal: Tuning
    models: Sequence[Plausible]
    sample_time_s: float
    evidence: Evidence = Evidence()
    boundaries: Sequence[NeighbourBoundary] = ()
    slower: Sequence[Tuning] = ()
    filter_s: float = 0.0
    urgent: bool = False
    locks: Locks = NO_LOCKS
    units: VendorUnits | None = None

    def __post_init__(self) -> None:
        if not 0 < self.sample_time_s < math.inf:
            raise ValueError(f"sample_time_s = {self.sample_time_s} must be positive and finite")
        if not 0 <= self.filter_s < math.inf:
            raise ValueError(f"filter_s = {self.filter_s} must be a finite time, 0 or more")
        excesses = [p.excess for p in self.models]
        if not all(0 <= excess < math.inf for excess in excesses) or (excesses and excesses[0] > min(excesses)):
            raise ValueError(f"models: excesses {excesses} must be finite, 0 or more, the first the least")

    def rounded(self, gains: PidGains) -> PidGains | None:
        """The set that the controller runs when it is given this one; None when it cannot hold it."""
        if self.units is None:
            return gains
        try:
            return self.units.rounded(gains)
        except ValueError:
            return None
