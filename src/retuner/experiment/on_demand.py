"""An experiment on demand from its first look at the loop to the question whether its settings may be written.

The confirmed settings into the controller: the same two-phase write, recorded before and after.

Once begun a write goes to its end: a person's Ctrl-C is heard when the controller has been read back.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import typer

from retuner.adaptive.experiments.phases import AbortCause, Phase
from retuner.adaptive.experiments.plan import Experiment, Plan
from retuner.adaptive.experiments.valve_test import FEWEST_HOLDS, ValveReading, read_valve_test
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.decision import gains_dict
from retuner.config import Config
from retuner.decision_page.svg import drawn
from retuner.drivers.device import Bench, Event, Reverted, WriteDone, WriteFailed, WriteRefusedError
from retuner.errors import UserError, user_input
from retuner.experiment.drawing import experiment_figure
from retuner.experiment.findings import (
    ExperimentFindings,
    ExperimentQuestion,
    described,
    evaluate,
    headline,
    valve_described,
)
from retuner.experiment.runner import ExperimentRunner, restore_patience_s
from retuner.experiment.target import p_only
from retuner.files import write_json, write_whole
from retuner.ledger import Ledger, Recorder
from retuner.report.console import RunScreen
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.stopping import unstoppable

# ---- What an experiment leaves behind: one JSON document, the record as CSV, the picture

RECORD, TREND, PICTURE, SUMMARY = "record.csv", "trend.csv", "experiment.png", "summary.json"
"""The experiment alone, which `retuner experiment --from` takes; everything from the first look on; the picture; what
was found."""
COLUMNS = ("t", "sp", "pv", "co", "mode", "limited")


@dataclass(slots=True)
class ExperimentResult:
    """How an experiment went.

    loop, unit : name of the loop, unit of pv. folder : where it is left. runner : over. found : None when too little
    was recorded. valve : what a valve test says. written : None when nothing was to be written, empty when the
    settings run, else why they do not.
    """

    loop: str
    unit: str
    folder: Path
    runner: ExperimentRunner
    found: ExperimentFindings | None = None
    valve: ValveReading | None = None
    written: str | None = None

    def to_dict(self) -> dict[str, object]:
        """Keys of Findings.to_dict, and ended, restored, touched, before, rest, samples, applied, write, folder."""
        runner = self.runner
        before, rest, cause = runner.before, runner.rest, runner.cause.name.lower() if runner.cause else None
        return {
            **(self.found.to_dict() if self.found else {"experiment": runner.plan.kind}),
            **({"valve": self.valve.to_dict()} if self.valve else {}),
            "ended": {"phase": runner.phase.name.lower(), "cause": cause, "text": runner.text},
            "restored": runner.phase is Phase.RESTORED,
            "touched": runner.touched,
            "before": before and {**before._asdict(), "gains": gains_dict(before.gains)},
            "rest": rest and rest._asdict(),
            "samples": len(runner.excited),
            "applied": self.written == "",
            "write": self.written,
            "folder": str(self.folder),
        }

    def leave(self) -> None:
        """Write the files, each whole."""
        runner, found = self.runner, self.found
        for name, samples in ((RECORD, runner.excited), (TREND, runner.samples)):
            rows = (f"{s.t_s!r},{s.sp!r},{s.pv!r},{s.co!r},{int(s.mode)},{int(s.limited)}" for s in samples)
            write_whole(self.folder / name, "\n".join((",".join(COLUMNS), *rows)) + "\n")
        if found is not None:
            title = f"{self.loop}, {runner.plan.kind}: {headline(found)}"
            band = (runner.plan.pv_low, runner.plan.pv_high)
            picture = experiment_figure(Window.of(runner.excited), found, title, self.unit, band)
            write_whole(self.folder / PICTURE, drawn(picture, title, ".png"))
        write_json(self.folder / SUMMARY, self.to_dict())


# ---- The confirmed settings into the controller

CONFIRM_SAMPLES = 15
"""Samples for which a set that runs is watched: the host confirms it in this time, or the controller takes it back."""


def write_settings(bench: Bench, sample_time_s: float, record: Recorder, gains: PidGains, base: PidGains) -> str:
    """Write one gain set and wait for the read-back; empty when it runs and stays, else one line that says why not.

    bench : the controller. sample_time_s : its sample time. record : keeps rows for good, before they take effect.
    gains : confirmed by a person. base : the set that ran when they were shown.

    Raises KeyboardInterrupt: the user stopped it meanwhile; the write went to its end first.
    """
    device, patience_s = bench.device, restore_patience_s(sample_time_s, bench.silent_s)
    stopped, now_s = False, 0.0

    def poll() -> list[Event]:
        nonlocal stopped, now_s
        try:
            now_s = bench.turn()
        except KeyboardInterrupt:
            stopped = True
        with unstoppable():
            return device.poll(now_s)

    def written() -> str:
        # until the controller answers: what is meant is recorded, then begun
        poll()
        until_s = now_s + patience_s
        while now_s < until_s:
            running = device.running
            if device.connected and running is not None and not device.writing:
                break
            poll()
        else:
            return "the controller does not answer; nothing was written"
        if running.gains != base:
            return "the active gains have changed since these settings were shown"
        what = {"gains": gains_dict(gains), "base": running.seq, "before": gains_dict(base)}
        record("intent", now_s, {"why": "experiment", **what})
        try:
            device.begin_write(gains, now_s)
        except WriteRefusedError as refusal:
            return str(refusal)
        # until the set is read back as running, with a later number where a lease ran out, and was watched for a while
        until_s, runs = now_s + patience_s, False
        while now_s < until_s:
            for event in poll():
                match event:
                    case WriteFailed():
                        return event.reason
                    case Reverted():
                        return "the controller returned to its confirmed gains"
                    case WriteDone():
                        read_back = {"sequence": event.seq, "gains": gains_dict(event.gains), "crc": event.running.crc}
                        record("committed", now_s, {"why": "experiment", **read_back})
                        until_s, runs = now_s + CONFIRM_SAMPLES * sample_time_s, True
        return "" if runs else "the controller does not answer; which set runs is not known"

    reason = written()
    if reason:
        record("refused", now_s, {"why": "experiment", "reason": reason})
    if stopped:
        raise KeyboardInterrupt
    return reason


INTERRUPTED = 130  # exit status after Ctrl-C, as shells have it
FEWEST_SAMPLES = 20  # shorter records are not evaluated
AFTER = {Phase.PARKING, Phase.RESTORING, Phase.RESTORED}  # phases behind the excitation
OPTION_AT_FAULT = {
    AbortCause.NO_ROOM: "--amplitude",
    AbortCause.WRONG_MODE: "setpoint",
    AbortCause.PV_BAND: "--pv-low, --pv-high",
}
"""Causes that are a matter of the options as long as nothing was changed."""


class OnDemandExperiment:
    """One experiment with everything round it.

    config : the loop. plan : what to do. question : what is asked of the record (what is seen at rest is filled in).
    folder, ledger : where it is left and recorded. screen : shows it. bench : where it takes place.
    yes : the settings are confirmed beforehand. as_json : print one JSON document.
    """

    def __init__(
        self,
        config: Config,
        plan: Plan,
        question: ExperimentQuestion,
        folder: Path,
        ledger: Ledger,
        screen: RunScreen,
        bench: Bench,
        *,
        yes: bool,
        as_json: bool,
    ) -> None:
        self._config, self._question, self._ledger = config, question, ledger
        self._screen, self._bench = screen, bench
        self._yes, self._as_json = yes, as_json
        runner = ExperimentRunner(
            bench.device, plan, config.loop.sample_time_s, bench.silent_s, self._to_ledger, self._on_sample
        )
        self._runner = runner
        self._outcome = ExperimentResult(config.loop.name, config.loop.pv_unit, folder, runner)

    def run(self) -> int:
        """Conduct, evaluate, offer, leave; the exit status.

        Raises UserError: the loop at rest shows that an option is wrong, or the ledger failed on the way.
        Raises DeviceError: nobody answers, or the wrong controller does.
        """
        runner, outcome = self._runner, self._outcome
        self._ledger.append("session", {"config": self._config.summary(), "retuner": version("retuner")}, 0.0)
        self._screen.begin(f"{self._config.loop.name}: {runner.plan.kind}")

        def stopping() -> None:
            if runner.phase.touched:
                self._screen.say("stopping: the initial state is being restored")

        runner.conduct(self._bench.turn, stopping)
        if runner.cause in OPTION_AT_FAULT and not runner.touched:
            raise UserError(f"{OPTION_AT_FAULT[runner.cause]}: {runner.text}; nothing was changed")
        held = bool(runner.plan.hold_s)
        outcome.found = None if held else self._evaluate()
        if len(runner.plan.moves) >= FEWEST_HOLDS and runner.cause is None:
            with user_input("the record of the test"):
                outcome.valve = read_valve_test(Window.of(runner.excited))
        with unstoppable():
            outcome.leave()
        self._tell()
        usable = outcome.found is not None and outcome.found.usable
        forbidden = self._forbidden() if usable else ""
        if forbidden:
            self._screen.say(f"not to be written: {forbidden}")
            outcome.written = forbidden
        elif runner.cause is None and usable and self._confirmed():
            assert outcome.found is not None
            assert outcome.found.chosen is not None
            assert runner.before is not None
            gains, dt_s = outcome.found.chosen.tuning.gains, self._config.loop.sample_time_s
            outcome.written = write_settings(self._bench, dt_s, self._to_ledger, gains, runner.before.gains)
            done = "written, read back and running; put them into the configuration to keep them"
            self._screen.say(f"NOT written: {outcome.written}" if outcome.written else done)
            with unstoppable():
                outcome.leave()
        if self._as_json:
            sys.stdout.write(json.dumps(outcome.to_dict(), indent=2, allow_nan=False) + "\n")
        if runner.lost_ledger is not None:
            raise runner.lost_ledger
        if runner.cause is AbortCause.INTERRUPTED:
            return INTERRUPTED
        return 0 if runner.cause is None and (usable or held) and not outcome.written else 1

    def _to_ledger(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """A row of the ledger; phases are told on the screen."""
        self._ledger.append(kind, body, t_s)
        if body.get("phase") not in {None, "before"}:
            phase = Phase[str(body["phase"]).upper()]
            if phase is not Phase.RESTORED or self._runner.touched:
                self._screen.say(f"{t_s:8,.0f} s {phase.value}" + (f" ({body['cause']})" if body.get("cause") else ""))

    def _on_sample(self, sample: LoopSample, phase: Phase) -> None:
        runner = self._runner
        since = (len(runner.samples) - runner.excited_from) * self._config.loop.sample_time_s
        progress = min(since / runner.plan.time_s, 1.0) if phase is Phase.EXCITING else float(phase in AFTER)
        self._screen.sample(sample, progress, phase.value)

    def _evaluate(self) -> ExperimentFindings | None:
        runner, asked = self._runner, self._question
        rest, before = runner.rest, runner.before
        if rest is None or before is None or len(runner.excited) < FEWEST_SAMPLES:
            return None
        kc = p_only(runner.plan, before).kp if runner.plan.kind == Experiment.SETPOINT else None
        question = replace(
            asked, kc=kc, hysteresis=rest.hysteresis, rest=(rest.pv, rest.co), from_rest=True, in_force=before.gains
        )
        return evaluate(Window.of(runner.excited), question)

    def _tell(self) -> None:
        """The result for a person; what needs one's hand goes to stderr in any case."""
        runner, found = self._runner, self._outcome.found
        ended = f"aborted: {runner.text}" if runner.cause else "done"
        record = self._outcome.folder / RECORD
        state = runner.phase.value if runner.touched else "nothing was changed"
        self._screen.say(f"{ended}; {state}; {len(runner.excited)} samples in {record}")
        nothing = ["too little was recorded for a result"]
        if self._outcome.valve is not None:
            nothing = valve_described(self._outcome.valve)
        elif runner.plan.hold_s and runner.cause is None:
            nothing = [f"next: retuner diagnose FIRST {record}, with FIRST for the record that asked for this test"]
        for line in described(found, settings=not runner.cause) if found else nothing:
            self._screen.say(line)
        if runner.phase is Phase.STRANDED:
            before = runner.before.words if runner.before else "the initial state"
            sys.stderr.write(
                f"{self._config.loop.name}: NOT RESTORED, the controller does not show its initial state; "
                f"bring back by hand: {before}\n"
            )

    def _forbidden(self) -> str:
        """Why nobody may write these settings, empty when a person may."""
        found, before = self._outcome.found, self._runner.before
        assert found is not None
        assert found.chosen is not None
        assert before is not None
        gains, limits = found.chosen.tuning.gains, self._config.adaptation
        if gains.direction != before.gains.direction:
            return "they act in the opposite direction to the active gains; check the sign of the process first"
        if limits.kc_max is not None and abs(gains.kp) > limits.kc_max:
            return f"|kp| = {abs(gains.kp):.4g} is above adaptation.kc_max = {limits.kc_max:g}"
        if limits.kc_min is not None and abs(gains.kp) < limits.kc_min:
            return f"|kp| = {abs(gains.kp):.4g} is below adaptation.kc_min = {limits.kc_min:g}"
        return ""

    def _confirmed(self) -> bool:
        if self._yes:
            return True
        if not self._as_json and sys.stdin.isatty():
            self._screen.pause()
            if typer.confirm("write these settings to the controller?", default=False):
                return True
        self._screen.say("nothing was written; confirm the settings with --yes, or y when asked")
        return False
