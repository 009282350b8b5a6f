"""What an experiment leaves behind: one JSON document, the record as CSV, the picture."""

from dataclasses import dataclass
from pathlib import Path

from retuner.adaptive.experiments.phases import Phase
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decision import gains_dict
from retuner.experiment.drawing import experiment_png
from retuner.experiment.findings import Findings, headline
from retuner.experiment.runner import Conductor
from retuner.files import write_whole
from retuner.session.outputs import SUMMARY, write_json

RECORD, TREND, PICTURE = "record.csv", "trend.csv", "experiment.png"
"""The experiment alone, which `retuner experiment --from` takes; everything from the first look on; the picture."""
COLUMNS = ("t", "sp", "pv", "co", "mode", "limited")


@dataclass(slots=True)
class Outcome:
    """How an experiment went.

    loop, unit : name of the loop, unit of pv. folder : where it is left. conductor : over. found : None when too little
    was recorded. written : None when nothing was to be written, empty when the settings run, else why they do not.
    """

    loop: str
    unit: str
    folder: Path
    conductor: Conductor
    found: Findings | None = None
    written: str | None = None

    @property
    def cause(self) -> str | None:
        """Name of the cause of an abort."""
        return self.conductor.cause.name.lower() if self.conductor.cause else None

    def to_dict(self) -> dict[str, object]:
        """Keys of Findings.to_dict, and ended, restored, touched, before, rest, samples, applied, write, folder."""
        conductor = self.conductor
        before, rest = conductor.before, conductor.rest
        return {
            **(self.found.to_dict() if self.found else {"experiment": conductor.plan.kind}),
            "ended": {"phase": conductor.phase.name.lower(), "cause": self.cause, "text": conductor.text},
            "restored": conductor.phase is Phase.RESTORED,
            "touched": conductor.touched,
            "before": before and {**before._asdict(), "gains": gains_dict(before.gains)},
            "rest": rest and rest._asdict(),
            "samples": len(conductor.excited),
            "applied": self.written == "",
            "write": self.written,
            "folder": str(self.folder),
        }

    def leave(self) -> None:
        """Write the files, each whole."""
        conductor, found = self.conductor, self.found
        for name, samples in ((RECORD, conductor.excited), (TREND, conductor.samples)):
            rows = (f"{s.t_s!r},{s.sp!r},{s.pv!r},{s.co!r},{int(s.mode)},{int(s.limited)}" for s in samples)
            write_whole(self.folder / name, "\n".join((",".join(COLUMNS), *rows)) + "\n")
        if found is not None:
            title = f"{self.loop}, {conductor.plan.kind}: {headline(found)}"
            band = (conductor.plan.pv_low, conductor.plan.pv_high)
            picture = experiment_png(Window.of(conductor.excited), found, title, self.unit, band)
            write_whole(self.folder / PICTURE, picture)
        write_json(self.folder / SUMMARY, self.to_dict())
