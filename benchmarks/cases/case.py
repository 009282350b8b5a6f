"""A drawn record with everything that is true of it."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Record:
    """What a historian would hold: time in seconds, setpoint, process value, controller output, each of shape (n,)."""

    t: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray


@dataclass(frozen=True, slots=True)
class IdentificationCase:
    """A record to identify from.

    group : how the record came about. family : of the process. gains : in force, None for an experiment in manual.
    co_min, co_max : limits of the output. process : the truth, without the sampling's own delay. best, best_pid : SIMC
    with perfect knowledge (half rule, tau_c = theta, theta + dt/2), PI and, where there is a second lag, PID.
    theta_eff_s : effective dead time of that PI. noise : standard deviation of the measurement noise, pv units.
    """

    group: str
    family: str
    seed: int
    index: int
    record: Record
    gains: PidGains | None
    co_min: float
    co_max: float
    process: LinearProcess
    dt_s: float
    best: PidGains
    best_pid: PidGains | None
    theta_eff_s: float
    noise: float
    note: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DiagnosisCase:
    """A record with the cause that made it.

    group : a cause, or the name of a trap. right : the answers that count as right. retune_right : whether a change of
    gains is. hidden : the cause by construction, where it is one of the eight; else what was built.
    """

    group: str
    family: str
    seed: int
    index: int
    record: Record
    gains: PidGains
    co_min: float
    co_max: float
    process: LinearProcess
    dt_s: float
    right: frozenset[str]
    retune_right: bool
    hidden: str
    best: PidGains
    theta_eff_s: float
    note: dict[str, float] = field(default_factory=dict)
