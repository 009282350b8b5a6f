"""Pretune before a run: a commanded step of co, the loop put back as it was, its record handed to the retuner.

    step of co, with limits -> old output, mode and gains verified -> first sample of the session: row, model, decision

The step is an experiment on demand (experiment/runner.py): every way out of it ends in the verified old state, or
the run does not begin. It has a link and a log of its own, so that a session begins with the session's first sample;
the record goes whole into the ledger, and from there into the retuner, live as in a replay.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping

from retuner.adaptive.experiments.phases import AbortCause, Phase
from retuner.adaptive.experiments.plan import Experiment, Plan
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Decision
from retuner.adaptive.supervision.retuner import Retuner
from retuner.config import Config
from retuner.drivers.device import Device
from retuner.errors import UserError, user_input
from retuner.experiment.runner import ExperimentRunner
from retuner.experiment.target import DEFAULT_DEVIATION, DEFAULT_SAMPLES, DEFAULT_SHARE, REST_WAIT_SAMPLES
from retuner.ledger import Recorder
from retuner.session.ledger_rows import feed

OrderTaker = Callable[[float], Iterable[Decision]]
"""What a session has: given the time of a sample, the decisions on what was ordered by then."""


class Pretuning:
    """One pretune.

    config : the loop. record : keeps rows for good. tell : says a line to the user.

    Raises UserError: a setting is out of its range.
    """

    def __init__(self, config: Config, record: Recorder, tell: Callable[[str], None]) -> None:
        self._config, self._record, self._tell = config, record, tell
        loop, dt = config.loop, config.loop.sample_time_s
        given = config.adaptation.pretune_step_pct
        with user_input("adaptation.pretune_step_pct"):
            self._plan = Plan(
                kind=Experiment.STEP,
                amplitude=DEFAULT_SHARE * (loop.co_max_pct - loop.co_min_pct) if given is None else given,
                pv_low=loop.pv_min,
                pv_high=loop.pv_max,
                deviation=DEFAULT_DEVIATION * (loop.pv_max - loop.pv_min),
                co_low=loop.co_min_pct,
                co_high=loop.co_max_pct,
                time_s=DEFAULT_SAMPLES * dt,
                rest_time_s=REST_WAIT_SAMPLES * dt,
            )
        self._samples: list[LoopSample] = []

    def conduct(self, device: Device, silent_s: float, turn: Callable[[], float]) -> None:
        """Make the step and put everything back. turn : lets time pass; the time in s.

        Raises UserError: the loop does not allow this step, or its old state could not be verified: it must not run on
        like this.
        Raises KeyboardInterrupt: the user stopped it; the old state came back first.
        Raises LedgerError: a row could not be kept; the old state came back first.
        Raises DeviceError: nobody answers, or the wrong controller does.
        """

        def note(kind: str, t_s: float, body: Mapping[str, object]) -> None:
            self._record(kind, 0.0, {**body, "at_s": t_s})

        conductor = ExperimentRunner(device, self._plan, self._config.loop.sample_time_s, silent_s, note)
        conductor.conduct(turn)
        if conductor.lost_ledger is not None:
            raise conductor.lost_ledger
        if conductor.phase is Phase.STRANDED:
            before = conductor.before
            raise UserError(
                f"pretune: NOT RESTORED ({conductor.text}), the run does not begin; restore by hand: "
                f"{before.words if before else 'the initial state'}"
            )
        if conductor.cause is AbortCause.INTERRUPTED:
            raise KeyboardInterrupt
        if conductor.cause is not None and not conductor.touched:
            raise UserError(f"pretune: {conductor.text}; nothing was changed")
        if conductor.cause is not None:
            self._tell(f"pretune aborted: {conductor.text}; {conductor.phase.value}; the run continues without it")
            return
        self._samples = conductor.excited
        self._tell(
            f"pretune: a step of {self._plan.amplitude:g} % of co, {len(self._samples)} samples; "
            f"{conductor.phase.value}"
        )

    def decisions(self, retuner: Retuner, later: Callable[[float], Iterable[Decision]]) -> OrderTaker:
        """What the session asks at its samples: the decision on the record once, and whatever comes `later`."""

        def take(t_s: float) -> Iterator[Decision]:
            if self._samples and retuner.region is not None:
                samples, self._samples = self._samples, []
                body = row(retuner.table.regions.names[retuner.region], samples)
                self._record("pretune", t_s, body)
                decision = feed(retuner, "pretune", body, t_s)
                if decision is not None:
                    yield decision
            yield from later(t_s)

        return take


def row(region: str, samples: list[LoopSample]) -> dict[str, object]:
    """The record as the ledger keeps it."""
    record = {name: [float(sample[i]) for sample in samples] for name, i in {"t": 0, "sp": 1, "pv": 2, "co": 3}.items()}
    return {"region": region, "step_samples": len(samples), "record": record}
