"""The confirmed settings into the controller: the same two-phase write, recorded before and after.

Once begun a write goes to its end: a person's Ctrl-C is heard when the controller has been read back.
"""

from retuner.adaptive.supervision.decision import gains_dict
from retuner.drivers.device import Bench, Event, Reverted, WriteDone, WriteFailed, WriteRefusedError
from retuner.experiment.runner import restore_patience_s
from retuner.ledger import Recorder
from retuner.schedule.gains import PidGains
from retuner.stopping import unstoppable

CONFIRM_SAMPLES = 15
"""Samples for which a set that runs is watched: the host confirms it in this time, or the controller takes it back."""


class SettingsWriter:
    """Writes one gain set.

    Parameters
    ----------
    bench : the controller. sample_time_s : its sample time. record : keeps rows for good, before they take effect.
    """

    def __init__(self, bench: Bench, sample_time_s: float, record: Recorder) -> None:
        self._bench, self._dt_s, self._record = bench, sample_time_s, record
        self._patience_s = restore_patience_s(sample_time_s, bench.silent_s)
        self._stopped = self._running = False
        self._now_s, self._seq = 0.0, -1

    def write(self, gains: PidGains, base: PidGains) -> str:
        """Write and wait for the read-back; empty when the set runs and stays, else one line that says why not.

        gains : confirmed by a person. base : the set that ran when they were shown.

        Raises
        ------
        KeyboardInterrupt
            The user stopped it meanwhile; the write went to its end first.
        """
        reason = self._begin(gains, base) or self._finish()
        if reason:
            self._record("refused", self._now_s, {"why": "experiment", "reason": reason})
        if self._stopped:
            raise KeyboardInterrupt
        return reason

    def _poll(self) -> list[Event]:
        """Let time pass, and hear what there is."""
        try:
            self._now_s = self._bench.turn()
        except KeyboardInterrupt:
            self._stopped = True
        with unstoppable():
            return self._bench.device.poll(self._now_s)

    def _begin(self, gains: PidGains, base: PidGains) -> str:
        """Stage and commit, once the controller is heard and runs what it ran."""
        device = self._bench.device
        self._poll()
        patience_s = self._now_s + self._patience_s
        while self._now_s < patience_s:
            running = device.running
            if device.connected and running is not None and not device.writing:
                if running.gains != base:
                    return "the active gains have changed since these settings were shown"
                self._record(
                    "intent",
                    self._now_s,
                    {"why": "experiment", "gains": gains_dict(gains), "base": running.seq, "before": gains_dict(base)},
                )
                try:
                    self._seq = device.begin_write(gains, self._now_s)
                except WriteRefusedError as refusal:
                    return str(refusal)
                return ""
            self._poll()
        return "the controller does not answer; nothing was written"

    def _finish(self) -> str:
        """Until the set has been read back as running, and has been watched for a while."""
        patience_s = self._now_s + self._patience_s
        while self._now_s < patience_s:
            for event in self._poll():
                match event:
                    case WriteFailed() if event.seq == self._seq:
                        return event.reason
                    case Reverted():
                        return "the controller returned to its confirmed gains"
                    case WriteDone() if event.seq == self._seq:
                        body = {
                            "why": "experiment",
                            "sequence": event.seq,
                            "gains": gains_dict(event.gains),
                            "crc": event.running.crc,
                        }
                        self._record("committed", self._now_s, body)
                        patience_s = self._now_s + CONFIRM_SAMPLES * self._dt_s
                        self._running = True
        return "" if self._running else "the controller does not answer; which set runs is not known"
