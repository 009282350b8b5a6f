"""Everything that is settled before a run begins."""

from dataclasses import dataclass, field
from pathlib import Path

from retuner.adaptive.supervision.decision import Mode
from retuner.commands.work.run_options import RunOptions
from retuner.config.session_config import SessionConfig
from retuner.files import Unwritten
from retuner.session.outputs import FreshFolder


@dataclass(frozen=True, slots=True)
class RunJob:
    """text : the configuration as its author wrote it. unwritten : what the system refuses of what the run leaves."""

    config: SessionConfig
    text: str
    mode: Mode | None
    speed: float
    fresh: FreshFolder
    options: RunOptions
    unwritten: Unwritten = field(default_factory=Unwritten)

    @property
    def folder(self) -> Path:
        """Where the run leaves everything."""
        return self.fresh.path

    @property
    def title(self) -> str:
        """What is run, in a few words."""
        first = self.config.loops[0]
        mode = self.mode or first.adaptation.mode
        return f"{len(self.config.loops)} loops" if self.config.several else f"{first.loop.name}: {mode}"
