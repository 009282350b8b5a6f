"""Telemetry to samples: joins the two halves of a sample, unwraps their 8-bit counter and notices what is missing.

The heartbeat carries the full 32-bit sample counter; a half belongs to the sample nearest to the newest one known with
these low 8 bits. Older or repeated halves are dropped, those further ahead than the heartbeats have said as well
(device_counter.py), and a half without its partner is soon forgotten. Telemetry carries one CRC-16 for both halves, so
halves that do not belong together make no sample. Time never goes back, and goes on across a restart of the device.
"""

import math
from typing import NamedTuple

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.protocol.checksum import sample_crc
from retuner.drivers.protocol.frames import RUNNING_TAG, TelemetryPv, TelemetrySp
from retuner.drivers.telemetry.device_counter import DeviceCounter, Said
from retuner.drivers.telemetry.signal_source import ScheduleInputs, SignalTap
from retuner.drivers.telemetry.telemetry_quality import Arrival, ArrivalCheck
from retuner.schedule.regions import CAN

WRAP = 256  # of the counter in the telemetry frames
HALF = WRAP // 2
PATIENCE = 16  # halves after which one that has met no partner is forgotten
SEQUENCES = 1 << 16
LONGEST_GAP = 1 << 16  # samples of outage over which time goes on after a restart
KEPT = 128  # samples whose content is remembered, to notice a second device that speaks under the same numbers


class AssembledSample(NamedTuple):
    """A sample, and how many before it never arrived."""

    sample: LoopSample
    lost: int


class SampleJoiner:
    """Unwrapped and joined telemetry of one device.

    sample_time_s : of the controller, s.
    variable : scheduling variable that goes into LoopSample.x: "sp", "pv" or "co"; or ScheduleInputs.
    node : of the device, for the CRC.
    after_s : time of the newest sample of an earlier session, which all of this one come behind, s; None for none.

    Raises ValueError: no such variable.
    """

    def __init__(
        self,
        sample_time_s: float,
        variable: str | ScheduleInputs = "sp",
        node: int = 1,
        after_s: float | None = None,
    ) -> None:
        inputs = ScheduleInputs.of(variable)
        self._sample_time_s, self._node = sample_time_s, node
        self._variable, self._variable2 = inputs.variable, inputs.variable2
        self.tap = SignalTap(inputs.signals)
        self._offset = 0
        self._counter = DeviceCounter()
        self.device_sample: int | None = None  # where the device's own counter stands; None while unknown
        self._after = None if after_s is None else round(after_s / sample_time_s)  # the earlier session's newest
        self._last: int | None = None
        self._first = 0  # the oldest sample that may be the first one
        self._said: dict[int, int] = {}
        self._again: dict[int, TelemetryPv | TelemetrySp] = {}
        self._contradicted: int | None = None
        self.contradictions = 0  # see _compare
        self._halves: dict[int, tuple[int, TelemetryPv | TelemetrySp]] = {}
        self._taken = self._beyond = 0
        self.arrivals = ArrivalCheck()
        self.running = 0  # sequence number of the set last known to run
        self.ordered: int | None = None  # and of the one that is being written

    def set_reference(self, sample: int) -> Said:
        """A heartbeat says that the counter stands here; what that means."""
        before = self._counter.newest
        said = self._counter.beat(sample, self._last)
        newest = self._counter.newest
        if newest is None or newest == before:
            return said
        self._beyond = 0
        after, self._after = self._after, None
        if after is not None and sample <= after:
            self._offset = after + 1 - sample
        if self.device_sample is None or sample > self.device_sample:
            self.device_sample = sample
        if self._last is None:
            self._first = sample
        return said

    def forget(self) -> None:
        """Contact was lost: the counter may have wrapped any number of times; the next reference tells."""
        self.arrivals.note(Arrival.TIMEOUT)
        self.device_sample = None
        self._counter.forget()
        self._halves.clear()

    def restart(self, sample: int, gap: int) -> None:
        """The device counts anew from sample; its time goes on gap samples (at least 1) after the last one."""
        last = self._last
        if last is not None:
            self._offset += last + max(gap, 1) - sample
            self._last = sample - 1
        self.device_sample = sample
        self._counter.begin(sample)
        self._halves.clear()
        self._said.clear()
        self._again.clear()

    def restart_after(self, sample: int, silence_s: float) -> int:
        """The device counts anew from sample, silence_s after the last one; the number of samples between."""
        intervals = silence_s / self._sample_time_s
        gap = round(intervals) if 1 < intervals < LONGEST_GAP else 1
        self.restart(sample, gap)
        return gap

    def take(self, half: TelemetryPv | TelemetrySp) -> AssembledSample | None:
        """Note half a sample; the sample once both halves are here."""
        if self.device_sample is None:
            return None
        ahead = (half.counter - self.device_sample) % WRAP
        number = self.device_sample + (ahead if ahead < HALF else ahead - WRAP)
        if self._last is not None and number <= self._last:
            if isinstance(half, TelemetrySp):
                self.arrivals.ahead(number - self._last)
            self._compare(number, half)
            return None
        if self._last is None and number < self._first:
            return None
        if self._counter.beyond(number):
            # half a sample further than the heartbeats have said; after many of them its low bits tell nothing either
            self.arrivals.note(Arrival.WRONG_SEQUENCE)
            self._beyond += 1
            if self._beyond >= HALF:
                self.device_sample = None
            return None
        self._taken += 1
        since, other = self._halves.get(number, (self._taken, None))
        if self._taken - since < PATIENCE:
            if isinstance(half, TelemetryPv) and isinstance(other, TelemetrySp):
                return self._join(number, half, other)
            if isinstance(half, TelemetrySp) and isinstance(other, TelemetryPv):
                return self._join(number, other, half)
        self._halves[number] = self._taken, half
        return None

    def _compare(self, number: int, half: TelemetryPv | TelemetrySp) -> None:
        """Half a sample under a number that has been: the same again, late, or what a second device says.

        Whole ones that say something else are counted, once between two new samples: a device that has booted says
        something else as well, but then nobody goes on with the old numbers.
        """
        other = self._again.pop(number, None)
        pv, sp = (half, other) if isinstance(half, TelemetryPv) else (other, half)
        if isinstance(pv, TelemetryPv) and isinstance(sp, TelemetrySp):
            differs = sp.crc == sample_crc(self._node, pv, sp) and self._said.get(number, sp.crc) != sp.crc
            if differs and self._last != self._contradicted:
                self._contradicted = self._last
                self.contradictions += 1
        else:
            self._again[number] = half
            if len(self._again) > PATIENCE:
                del self._again[next(iter(self._again))]

    def _join(self, number: int, pv: TelemetryPv, sp: TelemetrySp) -> AssembledSample | None:
        """The sample; what is older is given up. None when the halves do not belong together."""
        if sp.crc != sample_crc(self._node, pv, sp):
            self.arrivals.note(Arrival.WRONG_CRC)
            del self._halves[number]
            return None
        lost = 0 if self._last is None else number - self._last - 1
        self.arrivals.ahead(lost + 1)
        self._last = self.device_sample = number
        self._said[number] = sp.crc
        if len(self._said) > KEPT:
            del self._said[next(iter(self._said))]
        if len(self._halves) > 1:
            self._halves = {n: kept for n, kept in self._halves.items() if n > number}
        else:
            self._halves.clear()
        t_s = (number + self._offset) * self._sample_time_s
        x = _value(self._variable, pv, sp)
        x2 = _value(self._variable2, pv, sp) if self._variable2 else 0.0
        sample = LoopSample(t_s, sp.sp, pv.pv, pv.co, sp.mode, sp.limited, x, self._revision(sp.running), x2)
        return AssembledSample(self.tap.fill(sample), lost)

    def _revision(self, tag: int) -> int:
        """The sequence number with these low bits: the known one's, the ordered one's, else the next one upwards."""
        for known in (self.running, self.ordered):
            if known is not None and known % RUNNING_TAG == tag:
                return known
        return (self.running + (tag - self.running) % RUNNING_TAG) % SEQUENCES


def _value(variable: str, pv: TelemetryPv, sp: TelemetrySp) -> float:
    """A scheduling variable as the telemetry has it; NaN for one that comes otherwise."""
    if variable == "pv":
        return pv.pv
    return pv.co if variable == "co" else math.nan if variable == CAN else sp.sp
