"""What an experiment leaves behind: one JSON document, the record as CSV, the picture."""

from pathlib import Path

from retuner.adaptive.experiments.phases import Phase
from retuner.adaptive.experiments.valve_test import ValveReading
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decision import gains_dict
from retuner.decision_page.svg import drawn
from retuner.experiment.drawing import experiment_figure
from retuner.experiment.findings import ExperimentFindings, headline
from retuner.experiment.runner import ExperimentRunner
from retuner.files import write_json, write_whole
from retuner.schedule.late_dataclass import dataclass

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

    @property
    def cause(self) -> str | None:
        """Name of the cause of an abort."""
        return self.runner.cause.name.lower() if self.runner.cause else None

    def to_dict(self) -> dict[str, object]:
        """Keys of Findings.to_dict, and ended, restored, touched, before, rest, samples, applied, write, folder."""
        runner = self.runner
        before, rest = runner.before, runner.rest
        return {
            **(self.found.to_dict() if self.found else {"experiment": runner.plan.kind}),
            **({"valve": self.valve.to_dict()} if self.valve else {}),
            "ended": {"phase": runner.phase.name.lower(), "cause": self.cause, "text": runner.text},
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
