"""What ends an experiment: each limit a function or small watch that names the cause and what was seen, or nothing."""

from retuner.adaptive.experiments.phases import AbortCause
from retuner.adaptive.experiments.plan import Kind, Plan, RelayState, Rest
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.experiment.target import CO_SHOWN, Helm, Target

LIMITED_MOST = 2
"""Samples for which the output may stand at a limit during a setpoint experiment."""

Trouble = tuple[AbortCause, str]


def out_of_band(plan: Plan, sample: LoopSample) -> Trouble | None:
    """pv outside its band."""
    if plan.pv_low <= sample.pv <= plan.pv_high:
        return None
    return AbortCause.PV_BAND, f"pv = {sample.pv:.6g}, band {plan.pv_low:.6g} to {plan.pv_high:.6g}"


def cannot_begin(plan: Plan, rest: Rest, sample: LoopSample) -> Trouble | None:
    """No room for the amplitude, or the wrong mode."""
    low, high = plan.co_levels(rest.co)
    if not (plan.co_low <= low and high <= plan.co_high):
        return AbortCause.NO_ROOM, (
            f"co = {rest.co:.4g} % would go to {low:.4g} and {high:.4g} %, its range is "
            f"{plan.co_low:g} to {plan.co_high:g} %"
        )
    if plan.kind == Kind.SETPOINT and sample.mode != LoopMode.AUTO:
        return AbortCause.WRONG_MODE, "a setpoint experiment needs auto, it is in manual"
    return None


def out_of_time(plan: Plan, relay: RelayState, excited_s: float) -> Trouble | None:
    """The time limit of the excitation has passed."""
    if excited_s <= plan.time_s:
        return None
    if plan.kind == Kind.RELAY and relay.switches < 2:
        return AbortCause.NEVER_SWITCHED, (
            f"{plan.time_s:g} s for {relay.switches} switchings; are amplitude, bias and the "
            "sign of the active gains right?"
        )
    return AbortCause.TIME, f"{plan.time_s:g} s; give more time, or a larger amplitude"


class Following:
    """Whether the controller does what it is told: output, mode and setpoint.

    A new target may take some samples to show. Once mode and setpoint have shown, another one is somebody else's at
    once: the next output of a relay must not override a person who has taken over.

    Parameters
    ----------
    kind : of the experiment. helm : knows what is shown. patience : samples that a new target may take to show.
    """

    def __init__(self, kind: Kind, helm: Helm, patience: int) -> None:
        self._kind, self._helm, self._patience = kind, helm, patience
        self._limited = self._foreign = 0
        self._shown = False

    def expect(self) -> None:
        """The target has changed: it may take its time to show."""
        self._foreign, self._shown = 0, False

    def trouble(self, wanted: Target, sample: LoopSample) -> Trouble | None:
        """One sample under a target. In manual the setpoint may be anything: some controllers let it follow pv."""
        differs = self._helm.differs(wanted, sample)
        self._shown = self._shown or not differs
        self._foreign = self._foreign + 1 if differs else 0
        if self._foreign > (0 if self._shown else self._patience):
            return AbortCause.FOREIGN, differs
        if self._kind == Kind.SETPOINT:
            self._limited = self._limited + 1 if sample.limited else 0
            if self._limited > LIMITED_MOST:
                return AbortCause.SATURATED, f"co is at {sample.co:.4g} %; give a smaller amplitude or kc0"
            return None
        off = wanted.co is not None and sample.mode == LoopMode.MANUAL and abs(sample.co - wanted.co) > CO_SHOWN
        self._limited = self._limited + 1 if off else 0
        if self._limited > self._patience:
            return AbortCause.SATURATED, f"co is at {sample.co:.4g} %, commanded was {wanted.co:.4g} %"
        return None
