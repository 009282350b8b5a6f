"""What stands on the screen: progress of an experiment, each decision of a run in a line, a table per region."""

import sys
from typing import TextIO, cast

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Action, Decision
from retuner.decision_page.decision_sentences import MS_LIMIT, ms_text
from retuner.decision_page.decision_words import (
    cause_text,
    change_text,
    model_text,
    rolls_back,
    short_reason,
    short_settings,
    stays,
)
from retuner.decision_page.row_values import in_full
from retuner.decision_page.shown_units import units_of
from retuner.report.scores import RegionScore
from retuner.streams import LastingStream

ROLLED_BACK, KEPT = "ROLLED BACK", "kept"
COLOURS = {
    ROLLED_BACK: "bold red", "aggressive": "red", "sluggish": "yellow", "slow integrating": "yellow", "ok": "green",
}  # fmt: skip
MOST_CHARACTERS = 1000  # longer lines of a table are folded all the same
REFRESH_SAMPLES = 50  # the progress line is renewed every so many samples; more would cost more than the control loop


def screen_console(*, stderr: bool) -> Console:
    """A console on stdout, or stderr, that may go away under a run without ending it."""
    return Console(file=cast("TextIO", LastingStream(sys.stderr if stderr else sys.stdout)), highlight=False)


class RunScreen:
    """Progress of one experiment.

    console : where to. unit : of pv. quiet : show nothing (for --json). answers_only : no progress (for -q).
    """

    def __init__(self, console: Console, unit: str, *, quiet: bool = False, answers_only: bool = False) -> None:
        self.console = console
        self._unit = unit
        self._quiet = quiet
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            console=console,
            disable=quiet or answers_only or not console.is_terminal,
            transient=True,
        )
        self._task: TaskID | None = None
        self._samples = 0

    def __enter__(self) -> "RunScreen":
        if not self._progress.disable:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.pause()

    def pause(self) -> None:
        """No more progress: a question is going to be asked."""
        if not self._progress.disable:  # to stop one that shows nothing is an empty line with rich before 15
            self._progress.stop()

    def begin(self, text: str) -> None:
        """Start a bar."""
        if self._task is not None:
            self._progress.remove_task(self._task)
        self._task = self._progress.add_task(text, total=1.0, state="waiting for the controller")
        self._samples = 0

    def sample(self, sample: LoopSample, progress: float, region: str) -> None:
        """One sample has passed."""
        self._samples += 1
        if self._task is not None and self._samples % REFRESH_SAMPLES == 0:
            values = f"sp {sample.sp:.1f}  pv {sample.pv:.1f} {self._unit}  co {sample.co:.0f} %"
            state = f"t {in_full(sample.t_s)} s  {region}  {values}"
            self._progress.update(self._task, completed=progress, state=state)

    def say(self, text: str) -> None:
        """A line of plain text."""
        if not self._quiet:
            self._progress.console.print(escape(text), highlight=False, soft_wrap=True)


def counted(number: int, what: str) -> str:
    """A number of things, as people write it."""
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def live_line(decision: Decision, loop: str = "") -> str:
    """A decision as it is shown when it is taken, in rich's markup: when, where, cause, what is done or why not.

    loop : its name, where there are several.
    """
    back = rolls_back(decision)
    cause = ROLLED_BACK if back else KEPT if stays(decision) else cause_text(decision)
    colour = COLOURS.get(cause, "magenta")
    where = f"{loop} {decision.region}" if loop else decision.region
    head = f"[dim]{in_full(decision.t_s):>8} s[/] [bold]{escape(where):6}[/] [{colour}]{cause:10}[/]"
    told = [] if decision.action in {Action.WRITE, Action.ADVISE} else [escape(short_reason(decision))]
    told += [] if decision.action == Action.NONE else [f"[bold]{escape(change_text(decision))}[/]"]
    judged = decision.judgement.reason if decision.judgement and not back else ""
    told += [f"[cyan]trial: {escape(judged)}[/]"] if judged else []
    model = model_text(decision)
    return f"{head} {'; '.join(told)}{f'; [dim]model: {escape(model)}[/]' if model else ''}"


def scores_table(scores: list[RegionScore], unit: str, loop: str = "", ms_limit: float = MS_LIMIT) -> Table:
    """Gains, Ms and IAE per region, before and after. loop : its name, where there are several. ms_limit : Ms above it
    is marked.
    """
    compared = ", against the same run with fixed gains" if any(s.iae_fixed is not None for s in scores) else ""
    whose = f"{loop}: " if loop else ""
    over = any((s.ms_after or 0.0) > ms_limit for s in scores)
    limit = f" (!! over the limit of {ms_limit:g}: see the report)" if over else ""
    title = f"\n{whose}Gains as {units_of(loop).heads}; Ms on the simulated process{limit}; IAE in {unit} s{compared}"
    table = Table(title=escape(title), title_justify="left", box=None, padding=(0, 1, 0, 0))
    for name in ("region", "baseline", "final"):
        table.add_column(name, no_wrap=True)
    for name in ("writes", "baseline Ms", "final Ms", "IAE fixed", "IAE retuned"):
        table.add_column(name, justify="right", no_wrap=True)
    for s in scores:
        fixed = "-" if s.iae_fixed is None else in_full(s.iae_fixed)
        colour = "green" if s.iae_fixed is not None and s.iae < s.iae_fixed else "red"
        table.add_row(
            escape(s.region),
            short_settings(s.before, loop),
            short_settings(s.after, loop),
            str(s.changes),
            ms_text(s.ms_before),
            f"[bold red]{ms_text(s.ms_after)} !![/]" if (s.ms_after or 0.0) > ms_limit else ms_text(s.ms_after),
            fixed,
            in_full(s.iae) if s.iae_fixed is None or s.iae == s.iae_fixed else f"[{colour}]{in_full(s.iae)}[/]",
        )
    return table
