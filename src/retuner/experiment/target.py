"""What the controller should be in each phase of an experiment, and the helm that brings it there and looks."""

from typing import NamedTuple

from retuner.adaptive.experiments.phases import Phase
from retuner.adaptive.experiments.plan import Experiment, LoopAtRest, Plan, RelayState, relay_output
from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.decision_page.shown_units import units_of
from retuner.drivers.device import Device, WriteRefusedError
from retuner.schedule.gains import PidGains

SAME_SP = 1e-6  # setpoints closer than this share of their size are one: float32 again
CO_SHOWN = 0.001  # co is shown when telemetry differs from it by less, percent: ten steps of the wire's resolution
AGAIN_SAMPLES = 5  # samples to wait before what is not shown is sent once more


class OldState(NamedTuple):
    """The state to come back to. co counts when the mode is manual."""

    gains: PidGains
    sp: float
    mode: int
    co: float

    @property
    def words(self) -> str:
        """The mode and setpoint for a person who has to bring them back by hand."""
        return f"{units_of().text(self.gains)}, sp {self.sp:g}, mode {'auto' if self.mode else 'manual'}"


class Target(NamedTuple):
    """What the controller should be; None: whatever it is. co goes with mode manual."""

    gains: PidGains | None = None
    sp: float | None = None
    mode: int | None = None
    co: float | None = None


def target(
    phase: Phase, plan: Plan, before: OldState | None, rest: LoopAtRest | None, relay: RelayState, *, parking: bool
) -> Target:
    """The target of a phase; nothing before the loop has been seen at rest."""
    if before is None or rest is None:
        return Target()
    setpoint = plan.kind == Experiment.SETPOINT
    if phase is Phase.PREPARING:
        if setpoint:
            return Target(p_only(plan, before), before.sp, LoopMode.AUTO)
        return Target(mode=LoopMode.MANUAL, co=rest.co)
    if phase is Phase.EXCITING:
        if setpoint:
            return Target(p_only(plan, before), before.sp + plan.amplitude * relay.high, LoopMode.AUTO)
        if plan.kind == Experiment.VALVE:
            return Target(mode=LoopMode.MANUAL, co=rest.co + plan.co_of_hold(relay.switches))
        co = rest.co + plan.amplitude if plan.kind == Experiment.STEP else relay_output(plan, relay, rest)
        return Target(mode=LoopMode.MANUAL, co=co)
    if phase is Phase.PARKING and parking and not setpoint:
        return Target(mode=LoopMode.MANUAL, co=before.co)
    if phase is Phase.RESTORING:
        return Target(before.gains, before.sp, before.mode, before.co if before.mode == LoopMode.MANUAL else None)
    return Target()


def p_only(plan: Plan, before: OldState) -> PidGains:
    """The controller of the setpoint experiment: proportional, with the sign of the active gains; for a hold those."""
    if plan.hold_s:
        return before.gains
    return PidGains(before.gains.kp if plan.kc0 is None else plan.kc0, 0.0)


class Helm:
    """Sends what is wanted and tells whether it is shown.

    device : the controller. sample_time_s : its sample time.
    """

    def __init__(self, device: Device, sample_time_s: float) -> None:
        self._device = device
        self._again_s = AGAIN_SAMPLES * sample_time_s
        self.forget()

    def forget(self) -> None:
        """The controller has restarted: it knows nothing of what was sent."""
        self._mode: tuple[int, float | None] | None = None
        self._sp: float | None = None
        self._mode_s = self._sp_s = self._write_s = float("-inf")

    def shows(self, wanted: Target, sample: LoopSample) -> bool:
        """Whether telemetry and the read-back of the gains show the target."""
        if not (self._shows_mode(wanted, sample) and self._shows_sp(wanted, sample)):
            return False
        running, able = self._device.running, self._device.connected and not self._device.writing
        if wanted.gains is None:
            return True
        return running is not None and able and change_factor(running.gains, wanted.gains) <= SAME_GAINS

    def differs(self, wanted: Target, sample: LoopSample) -> str:
        """Words for mode or setpoint where they are not the target's, empty when they are right."""
        if wanted.mode is not None and sample.mode != wanted.mode:
            return f"it is in {LoopMode(sample.mode).name.lower()}"
        return "" if self._shows_sp(wanted, sample) else f"its setpoint is {sample.sp:.6g}"

    def _shows_mode(self, wanted: Target, sample: LoopSample) -> bool:
        if wanted.mode is None:
            return True
        return sample.mode == wanted.mode and (wanted.co is None or abs(sample.co - wanted.co) <= CO_SHOWN)

    def _shows_sp(self, wanted: Target, sample: LoopSample) -> bool:
        return wanted.sp is None or abs(sample.sp - wanted.sp) <= SAME_SP * max(abs(wanted.sp), 1.0)

    def steer(self, wanted: Target, sample: LoopSample | None, now_s: float, *, insist: bool) -> str:
        """Send what is not shown; why it was refused, empty when it was not.

        insist : send again what is still not shown after a while, and write gains.
        """
        if sample is None:
            return ""
        try:
            if wanted.mode is not None:
                want = (int(wanted.mode), wanted.co)
                new = want != self._mode and not (self._mode is None and self._shows_mode(wanted, sample))
                overdue = insist and now_s - self._mode_s > self._again_s and not self._shows_mode(wanted, sample)
                if new or overdue:
                    co = sample.co if wanted.co is None else wanted.co
                    self._device.send_mode(auto=wanted.mode == LoopMode.AUTO, co=co, now_s=now_s)
                    self._mode, self._mode_s = want, now_s
            if wanted.sp is not None:
                new = wanted.sp != self._sp and not (self._sp is None and self._shows_sp(wanted, sample))
                overdue = insist and now_s - self._sp_s > self._again_s and not self._shows_sp(wanted, sample)
                if new or overdue:
                    self._device.send_setpoint(wanted.sp, now_s)
                    self._sp, self._sp_s = wanted.sp, now_s
            if insist:
                running = self._device.running
                able = self._device.connected and not self._device.writing and now_s >= self._write_s
                if wanted.gains is None or running is None or not able:
                    return ""
                if change_factor(running.gains, wanted.gains) > SAME_GAINS:
                    self._write_s = now_s + self._again_s
                    self._device.begin_write(wanted.gains, now_s)
        except WriteRefusedError as refused:
            return str(refused)
        return ""


# What an experiment on demand does unless it is told otherwise.


DEFAULT_SHARE = 0.05  # amplitude as a share of the range of co (step, relay) or pv (setpoint) unless it is given
DEFAULT_DEVIATION = 0.2  # pv may go this share of its range away from rest unless another deviation is given
DEFAULT_SAMPLES, REST_WAIT_SAMPLES = 2000, 300
"""Time limits of the excitation and of the wait for rest, in samples, unless they are given."""
