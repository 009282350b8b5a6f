"""The test that a diagnosis proposes; deciding_test.py works it out."""

from enum import StrEnum

from retuner.schedule.late_dataclass import dataclass


class TestKind(StrEnum):
    """SETPOINT : a step of the setpoint out and back. VALVE : in manual, steps of co up, up, down and down."""

    __test__ = False  # no class of tests, whatever its name begins with

    SETPOINT = "setpoint"
    VALVE = "valve"


@dataclass(frozen=True, slots=True)
class DecidingTest:
    """A test to make. size : of each step, pv units, or co units for a valve.

    hold_s : how long each step is held. decides : probability that the record of it leaves one cause at 90 %.
    """

    kind: TestKind
    size: float
    hold_s: float
    decides: float

    def to_dict(self) -> dict[str, object]:
        """Keys kind, size, hold_s, decides."""
        return {"kind": str(self.kind), "size": self.size, "hold_s": self.hold_s, "decides": self.decides}
