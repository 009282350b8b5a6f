"""Address and patience of the host towards one controller on CAN."""

import math
import secrets

from retuner.drivers.protocol.frames import OWNER_TAG
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.late_dataclass import dataclass, field

TIMES = (
    "sample_time_s", "reply_samples", "reply_floor_s", "silent_samples", "connect_samples", "connect_floor_s",
    "lease_samples", "lease_floor_s",
)  # fmt: skip
OWNERS = 65535  # the owner's number has 16 bits; 0 is nobody
LEASE_SAMPLES_MAX = 65535
KEY_BYTES_MIN = 16


@dataclass(frozen=True, slots=True)
class CanDeviceSettings:
    """How to reach a controller and how long to wait for it.

    node : address of the controller, 1..63.
    sample_time_s : its sample time in s; another one found there is refused.
    variable : scheduling variable for LoopSample.x: "sp", "pv" or "co"; or ScheduleInputs.
    reply_samples : samples to wait for an answer before the next try.
    reply_floor_s : the same at least in s, for controllers faster than an operating system answers.
    silent_samples : samples without any frame of the node after which it counts as silent.
    connect_samples : samples after which the first connection is given up.
    connect_floor_s : the same at least in s.
    owner : this host's number in the lease, 1..65535; hosts on one bus need different ones (fresh_owner).
    lease_samples : length of the lease in samples: what a host that died leaves the loop locked for.
    lease_floor_s : the same at least in s.
    probation_samples : samples that must show a newly written set running before it is confirmed.
    key : secret that commits are authenticated with, at least 16 bytes; None for none.

    Raises ValueError: a number is not positive, or out of its range.
    """

    node: int = 1
    sample_time_s: float = 2.0
    variable: str | ScheduleInputs = "sp"
    reply_samples: float = 3.0
    reply_floor_s: float = 0.25
    silent_samples: float = 6.0
    connect_samples: float = 20.0
    connect_floor_s: float = 5.0
    owner: int = 1
    lease_samples: float = 30.0
    lease_floor_s: float = 3.0
    probation_samples: int = 5
    key: bytes | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in TIMES:
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"device: {name} = {getattr(self, name)}; give a positive number")
        if not 1 <= self.owner <= OWNERS:
            raise ValueError(f"device: owner = {self.owner}; give 1 to {OWNERS}")
        if self.probation_samples < 0:
            raise ValueError(f"device: probation_samples = {self.probation_samples}; give 0 or more")
        if self.key is not None and len(self.key) < KEY_BYTES_MIN:
            raise ValueError(f"device: the key has {len(self.key)} bytes; give at least {KEY_BYTES_MIN}")

    @property
    def lease_length(self) -> int:
        """Length of the lease in samples."""
        return min(math.ceil(max(self.lease_samples, self.lease_floor_s / self.sample_time_s, 1.0)), LEASE_SAMPLES_MAX)

    @property
    def reply_s(self) -> float:
        """How long to wait for an answer, s."""
        return max(self.reply_samples * self.sample_time_s, self.reply_floor_s)

    @property
    def silent_s(self) -> float:
        """Age of the last frame at which the node counts as silent, s."""
        return max(self.silent_samples * self.sample_time_s, 4 * self.reply_floor_s)

    @property
    def connect_s(self) -> float:
        """How long the first connection may take, s."""
        return max(self.connect_samples * self.sample_time_s, self.connect_floor_s)


def fresh_owner() -> int:
    """A number for a host process that was given none: random, so that two hosts tell each other apart.

    Its low bits are not 0, so that nobody who sees only those (STAGE, STORE) takes it for no owner at all.
    """
    return OWNER_TAG * secrets.randbelow((OWNERS + 1) // OWNER_TAG) + 1 + secrets.randbelow(OWNER_TAG - 1)
