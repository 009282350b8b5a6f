"""The layers of the lease and of commands: one owner, of the present time, with counters that go forward."""

from bus_simulation.layers.seen import Told, unchanged
from bus_simulation.layers.wire import LOAD, MODE, SETPOINT, STAMP_SAMPLES, Ack, broken, float32, newer, stamp, u16
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings

OK, STALE, OUT_OF_RANGE, NOT_OWNER = 0, 1, 10, 13
CO_STEP = 0.0001


class Leases:
    """Who may command, and until when.

    longest : samples of the longest lease.
    """

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._last = b""
        self._left = 0

    def anew(self) -> "Leases":
        """The same after a restart: nobody holds it."""
        return Leases(self._longest)

    def asked(self, told: Told) -> None:
        """A LEASE frame and its answer."""
        data, before, after = told.data, told.before, told.after
        owner, samples = u16(data), u16(data[4:])
        ack = Ack(told.replies[0])
        epoch, sample, holder = told.before.epoch, told.before.sample, told.before.owner
        if u16(data[2:]) not in {stamp(epoch, sample), stamp(epoch, max(sample - STAMP_SAMPLES, 0))}:
            right = STALE
        elif holder not in {0, u16(data)}:
            right = NOT_OWNER
        else:
            is_next = data[:2] != self._last[:2] or data == self._last or newer(data[6], self._last[6], 8)
            right = OK if is_next else STALE
        if (ack.seq, ack.reason, ack.latest) != (owner, right, after.owner):
            raise broken("leases_are_fresh", f"{data.hex()} gets {vars(ack)}, reason {right} is right")
        if right == OK and data != self._last:
            self._last, self._left = data, min(samples, self._longest)
            if after.owner != (owner if self._left else 0):
                raise broken("leases_are_fresh", f"{after.owner} holds it after {data.hex()}")
        elif after.owner != before.owner:
            raise broken("leases_are_fresh", f"{after.owner} holds it after {data.hex()}, which counts for nothing")
        unchanged("leases_are_fresh", before, after, "owner", "has_staged")

    def sampled(self, before: int, after: int) -> None:
        """A controller sample has passed."""
        self._left -= before != 0
        if after != (before if self._left > 0 else 0):
            raise broken("leases_end", f"{after} holds it after a sample with {self._left} samples left of {before}'s")


class Commands:
    """Setpoint, mode and load.

    settings : ranges of the device.
    """

    def __init__(self, settings: VirtualDeviceSettings) -> None:
        self._settings = settings
        self._last: dict[int, bytes] = {}

    def came(self, told: Told) -> None:
        """A command and its answer."""
        kind, data, before = told.command, told.data, told.before
        last = self._last.get(kind)
        ack, right, latest = Ack(told.replies[0]), OK, data[0]
        if u16(data[5:]) != before.owner:
            right = NOT_OWNER
        elif last is not None and data != last and not newer(data[0], last[0], 8):
            right, latest = STALE, last[0]
        elif not self._inside(kind, data):
            right = OUT_OF_RANGE
        if (ack.seq, ack.reason, ack.latest) != (data[0], right, latest):
            raise broken("commands_go_forward", f"{kind}: {data.hex()} gets {vars(ack)}, reason {right} is right")
        acts = right == OK and data != last
        if acts:
            self._last[kind] = data
        kind, data, after = told.command, told.data, told.after
        name = {SETPOINT: "sp", MODE: "auto", LOAD: "load"}[kind]
        unchanged("commands_go_forward", told.before, after, *((name,) if acts else ()))
        aim = data[1] == 1 if kind == MODE else float32(data[1:5])
        if acts and getattr(after, name) != aim:
            raise broken("commands_go_forward", f"{name} is {getattr(after, name)}, told was {aim}")

    def _inside(self, kind: int, data: bytes) -> bool:
        """Whether the device may do it."""
        s = self._settings
        if kind == SETPOINT:
            return s.sp_min <= float32(data[1:5]) <= s.sp_max
        co = int.from_bytes(data[2:5], "little", signed=True) * CO_STEP
        return kind == LOAD or data[1] == 1 or s.co_min <= co <= s.co_max


LEASED = {SETPOINT, MODE, LOAD}
