"""What is burnt into the firmware of a virtual controller."""

from retuner.drivers.protocol.frames import GainBox
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.pid import PidLaw, law

CO_WIRE = (-100.0, 200.0)  # percent, range of co in retuner.dbc
SAMPLES_MAX = 65535  # 16 bits
LEASE_SAMPLES, LEASE_S = 600, 6.0  # twenty times, twice what a host asks for when nobody says otherwise


@dataclass(frozen=True, slots=True)
class VirtualDeviceSettings:
    """What is burnt into the firmware.

    gains : set that runs until another is committed or found in the store.
    node : address on the bus, 1..63.
    sample_time_s : controller sample time in s.
    box : gains that the device accepts.
    sp_min, sp_max : setpoints that it accepts, pv units.
    co_min, co_max : range of the output, percent, within -100..200.
    co_rate_per_s : largest rate of the output, percent per second; None for no limit.
    co_fault : output while a fault is told, percent; limited to the range, reached at once.
    b : setpoint weight. tau_f_s : filter time of the derivative, s.
    heartbeat_samples : samples between life signs.
    lease_longest_samples : longest lease that it grants: a lost request that a repeater sends later locks the loop so
        long; None for 600 samples, or 6 s where that is more.
    trial_samples : samples within which a host must confirm a new set, or the confirmed one runs again; 0 for ever.
    key : secret that commits must be authenticated with; None for none.

    Raises ValueError: a setting is outside its range (named).
    """

    gains: PidGains
    node: int = 1
    sample_time_s: float = 2.0
    box: GainBox = field(default_factory=GainBox)
    sp_min: float = -1e9
    sp_max: float = 1e9
    co_min: float = 0.0
    co_max: float = 100.0
    co_rate_per_s: float | None = None
    co_fault: float = 0.0
    b: float = 1.0
    tau_f_s: float = 0.0
    heartbeat_samples: int = 5
    lease_longest_samples: int | None = None
    trial_samples: int = 0
    key: bytes | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not 1e-4 <= self.sample_time_s <= 3600:
            raise ValueError(f"device: sample_time_s = {self.sample_time_s}; give 0.0001 to 3600 s")
        if not CO_WIRE[0] <= self.co_min < self.co_max <= CO_WIRE[1]:
            raise ValueError(f"device: co {self.co_min}..{self.co_max}; give a range within {CO_WIRE}")
        if not CO_WIRE[0] <= self.co_fault <= CO_WIRE[1]:
            raise ValueError(f"device: co_fault = {self.co_fault}; give a number within {CO_WIRE}")
        if not self.sp_min < self.sp_max:
            raise ValueError(f"device: sp_min = {self.sp_min} must be below sp_max = {self.sp_max}")
        if not 1 <= self.heartbeat_samples <= 100:
            raise ValueError(f"device: heartbeat_samples = {self.heartbeat_samples}; give 1 to 100")
        for name, value, low in (
            ("lease_longest_samples", self.lease_longest, 1),
            ("trial_samples", self.trial_samples, 0),
        ):
            if not low <= value <= SAMPLES_MAX:
                raise ValueError(f"device: {name} = {value}; give {low} to {SAMPLES_MAX}")
        self.law_of(self.gains)

    @property
    def lease_longest(self) -> int:
        """Longest lease that it grants, samples."""
        if self.lease_longest_samples is not None:
            return self.lease_longest_samples
        return int(min(max(LEASE_SAMPLES, LEASE_S / self.sample_time_s), SAMPLES_MAX))

    def law_of(self, gains: PidGains) -> PidLaw:
        """The PID law with these gains."""
        return law(
            gains,
            b=self.b,
            tau_f_s=self.tau_f_s,
            co_min=self.co_min,
            co_max=self.co_max,
            co_rate_per_s=self.co_rate_per_s,
        )
