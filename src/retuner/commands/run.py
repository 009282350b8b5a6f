"""retuner run: watch and retune a loop, and leave report, ledger, trend and bus log behind."""

import json
import platform
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from retuner.adaptive.region_model.region_advice import AdviceSettings, RegionAdvice, region_advice
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Mode, gains_dict
from retuner.adaptive.trial.phase import TrialPhase
from retuner.commands.options import Channel, ConfigFile, Interface, Json, on_bus, signed_by
from retuner.commands.report import scores_of
from retuner.config.loading import load_with_text
from retuner.config.model import Config
from retuner.drivers.bus.bus_log import log_parts
from retuner.drivers.device import DeviceError
from retuner.errors import LedgerError, UserError
from retuner.files import write_json, write_whole
from retuner.ledger import Ledger, Recorder
from retuner.live_view.live_screen import LiveScreen
from retuner.live_view.loop_seen import LoopObserver
from retuner.live_view.publishing import Publisher, head_of
from retuner.live_view.what_next import narrow_scores, what_next
from retuner.report.console import counted, scores_table, screen_console, told_values
from retuner.report.report import ReportData, render
from retuner.report.scores import RegionScore
from retuner.report.trend import require_writer, write_trend
from retuner.schedule.document import to_toml
from retuner.serve.beside import require_page, served_beside
from retuner.session.assembly import make_plant
from retuner.session.outputs import (
    BUS_LOG,
    CONFIG,
    GAINS,
    LEDGER,
    REPORT,
    SUMMARY,
    TREND,
    FreshFolder,
    fresh_folder,
    give_back,
)
from retuner.session.running import Run, nothing, real_time_speed
from retuner.session.session import Session
from retuner.session.session_identity import file_sha256, session_identity
from retuner.stopping import stoppable, unstoppable

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Watch a loop, retune it over CAN, and leave a report."""

    config: ConfigFile
    interface: Interface = None
    channel: Channel = None
    speed: Annotated[
        str, typer.Option(help="max: simulated time; a number: how much faster than real time the device runs.")
    ] = "max"
    mode: Annotated[str | None, typer.Option(help="off, advise, trial or auto; overrides the configuration.")] = None
    out: Annotated[Path | None, typer.Option(help="Folder for report, ledger, trend and bus log.")] = None
    compare: Annotated[bool, typer.Option(help="Also run with fixed gains, where the plant is simulated.")] = True
    pretune: Annotated[bool, typer.Option("--pretune", help="Begin with a step of co: first model and gains.")] = False
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="On a terminal: what decisions weighed.")] = False
    serve: Annotated[bool, typer.Option("--serve", help="Show it in a browser while it runs.")] = False
    as_json: Json = False


@app.command(epilog="Example: retuner run examples/oven.toml --out runs/oven")
@signed_by(RunOptions)
def run(options: RunOptions) -> int:
    """Run a configuration; the exit status.

    Raises
    ------
    ConfigError, UserError, DeviceError
        The configuration, the options, the folder or the bus cannot be used, one line each.
    """
    read, text = load_with_text(options.config)
    config = on_bus(read, options.interface, options.channel)
    if options.pretune:
        config = config.model_copy(update={"adaptation": config.adaptation.model_copy(update={"pretune": True})})
    if options.mode is not None and options.mode not in set(Mode):
        raise UserError(f"--mode {options.mode}: give one of {', '.join(Mode)}")
    mode = Mode(options.mode) if options.mode else None
    simulated = config.bus.interface == "virtual"
    if simulated and config.scenario is None:
        raise UserError(f"{options.config}: a simulated run needs a [scenario] with its length and steps; add one")
    if simulated:
        make_plant(config)
    speed = real_time_speed(options.speed, simulated=simulated)
    folder = options.out or Path(config.output.directory)
    console = screen_console(stderr=options.as_json)
    screen = LiveScreen(console, config.loop.pv_unit, quiet=options.as_json, detail=options.verbose)
    require_writer(config.output.trend)
    require_page(wanted=options.serve)
    fresh = fresh_folder(folder)
    try:
        with stoppable(), Ledger(folder / LEDGER) as ledger, screen:
            if fresh.moved:
                screen.say(f"the earlier run in {folder} was moved to {fresh.moved}")
            return _run(_Job(config, text, mode, speed, fresh, options, simulated), ledger, screen)
    except NothingHappenedError as nothing_happened:
        give_back(fresh)
        raise nothing_happened.cause from None
    except LedgerError:  # it could not be opened
        give_back(fresh)
        raise


class NothingHappenedError(Exception):
    """The run ended before the first sample: nothing is worth keeping. cause is what the user is told."""

    def __init__(self, cause: BaseException) -> None:
        self.cause = cause
        super().__init__(str(cause))


@dataclass(frozen=True, slots=True)
class _Job:
    """Everything that is settled before a run begins. text : the configuration as its author wrote it."""

    config: Config
    text: str
    mode: Mode | None
    speed: float
    fresh: FreshFolder
    options: RunOptions
    simulated: bool

    @property
    def folder(self) -> Path:
        """Where the run leaves everything."""
        return self.fresh.path


def _run(job: _Job, ledger: Ledger, screen: LiveScreen) -> int:
    """The run itself, the comparison run and what is left behind, also after Ctrl-C."""
    config = job.config
    _open_session(job, ledger)

    watched = Watched(job, screen)
    record = _recorder(ledger, screen, lambda: job_run.session, config.output.ledger_mb_warn)
    job_run: Run = Run(
        config,
        record,
        mode=job.mode,
        log=job.folder / BUS_LOG,
        on_sample=watched.sample,
        folder=job.folder,
        before=job.fresh.moved,
        tell=screen.say,
    )
    screen.begin(f"{config.loop.name}: {job.mode or config.adaptation.mode}")
    session, interrupted = _served(job, job_run, watched, screen)
    end = {"interrupted": interrupted, **_traffic(job.folder)}
    fixed = None
    if job.simulated and job.options.compare and not interrupted:
        compared = Watched(job, screen, published=False)
        fixed = _unless_stopped(Run(config, nothing, mode=Mode.OFF, on_sample=compared.sample), screen)
        interrupted = fixed is None
    with unstoppable():
        record("end", session.writer.t_s, end)
        _leave(job, ledger, session, fixed, screen, interrupted=interrupted)
    if session.frozen or session.left_open:
        wrong = session.frozen or session.left_open
        raise UserError(f"{wrong}; the run was ended, and {job.folder / REPORT} says what the controller runs")
    return 130 if interrupted else 0


class Watched:
    """Shows each sample of a session on the screen, and to whoever watches from outside (published)."""

    def __init__(self, job: _Job, screen: LiveScreen, *, published: bool = True) -> None:
        self._job, self._screen, self._published = job, screen, published
        self._observer: LoopObserver | None = None
        self._publisher: Publisher | None = None

    def sample(self, session: Session, sample: LoopSample) -> None:
        """One sample has been taken in."""
        observer = self._observer
        if observer is None:
            observer = self._observer = LoopObserver(session.retuner, session.device)
            if self._published:
                head = head_of(self._job.config, session.table)
                self._publisher = Publisher(self._job.folder, head, observer, self._screen.say)
        if self._publisher is not None:
            self._publisher.sample(sample)
        self._screen.sample(session.table.loop, sample.pv, session.scenario.progress, lambda: observer.look(sample))

    def close(self) -> None:
        """The session is over."""
        if self._publisher is not None:
            self._publisher.close()


def _traffic(folder: Path) -> dict[str, object]:
    """The bus log by its name and by the hash of its parts one after the other."""
    return {"bus_log": BUS_LOG, "bus_log_sha256": file_sha256(*log_parts(folder / BUS_LOG).paths)}


def _open_session(job: _Job, ledger: Ledger) -> None:
    """Put the configuration as run into the folder, and what the run is made with into the ledger's first row.

    Raises
    ------
    NothingHappenedError
        One of them cannot be written.
    """
    options = job.options
    named = {
        ("adaptation", "mode"): options.mode,
        ("bus", "interface"): options.interface,
        ("bus", "channel"): options.channel,
        ("adaptation", "pretune"): options.pretune or None,
    }
    changes = {place: value for place, value in named.items() if value is not None}
    text, identity = session_identity(job.config, job.text, changes)
    body = {"config": job.config.summary(), "retuner": version("retuner"), **identity, "samples": 0}
    try:
        write_whole(job.folder / CONFIG, text)
        ledger.append("session", body, 0.0)
    except (LedgerError, OSError) as error:
        raise NothingHappenedError(error) from error


class LedgerSize:
    """Says once that a ledger has grown past its size; it is never cut, because it is the record of what was decided.

    most_mb : the size in MB. say : is told the one line.
    """

    def __init__(self, ledger: Ledger, most_mb: float, say: Callable[[str], None]) -> None:
        self._ledger = ledger
        self._most_mb = most_mb
        self._say = say
        self._told = False

    def look(self) -> None:
        """Look at the file; called after each row."""
        if not self._told and self._ledger.size_bytes() > self._most_mb * 1e6:
            self._told = True
            self._say(
                f"{self._ledger.path}: has grown past {self._most_mb:g} MB ([output] ledger_mb_warn) and is never cut; "
                "when the disk is short, end this run and begin another, which starts a new ledger"
            )


def _recorder(ledger: Ledger, screen: LiveScreen, current: Callable[[], Session | None], most_mb: float) -> Recorder:
    """What keeps a run's rows and shows some of them; a ledger that fails freezes the session.

    most_mb : size of the ledger past which that is told.
    """
    size = LedgerSize(ledger, most_mb, screen.say)

    def record(kind: str, t_s: float, body: Mapping[str, object]) -> None:
        session = current()
        try:
            ledger.append(kind, {**body, "samples": session.samples if session else 0}, t_s)
        except LedgerError as error:  # an alarm; the controller goes on with what it runs
            if session is None:
                raise
            if not session.frozen:
                session.freeze(str(error))
                screen.say(f"{error}; nothing more is changed, and the run ends")
            return
        size.look()
        if kind == "decision" and session is not None:
            screen.decision(session.decisions[-1])
        elif kind in TOLD:
            screen.say(f"{t_s:8,.0f} s {kind}: {told_values(body, TOLD[kind])}")

    return record


def _served(job: _Job, job_run: Run, watched: Watched, screen: LiveScreen) -> tuple[Session, bool]:
    """The run to its end, with its page beside it where that is wanted."""
    with served_beside(job.folder, screen.say, wanted=job.options.serve):
        try:
            return _play(job, job_run)
        finally:
            watched.close()


def _play(job: _Job, job_run: Run) -> tuple[Session, bool]:
    """The run to its end, or until it was stopped: what there is, and whether it was stopped."""
    try:
        return (job_run.simulated() if job.simulated else job_run.live(job.speed)), False
    except (KeyboardInterrupt, DeviceError) as stop:
        if job_run.session is None or not job_run.session.trend.rows:
            raise NothingHappenedError(stop) from stop
        return job_run.session, True


def _unless_stopped(comparison: Run, screen: LiveScreen) -> Session | None:
    """The comparison run, or None when the user stops it: the run that counts is over then, and is kept."""
    screen.begin("the same run with fixed gains")
    try:
        return comparison.simulated()
    except KeyboardInterrupt:
        return None


TOLD = {
    "refused": ("region", "reason"),
    "link": ("state", "reason"),
    "restart": ("epoch",),
    "lost": ("count",),
    "command": ("command", "reason"),
    "worker": ("reason",),
    "unknown": ("reason",),
    "foreign": ("gains",),
    "dropped": ("reason",),
    "bus": ("fault", "times"),
    "variable": ("name", "reason"),
    "abort": ("reason",),
    "restored": ("regions",),
    "lockout": ("region", "undos"),
    "unrestored": ("regions", "reason"),
    "order": ("order", "by", "accepted", "reason"),
}
"""Rows beside decisions that a person at the screen should see, and which of their values."""


def _leave(
    job: _Job, ledger: Ledger, session: Session, fixed: Session | None, screen: LiveScreen, *, interrupted: bool
) -> None:
    """Write everything that the run leaves, and show the result."""
    config, folder = job.config, job.folder
    columns = session.trend.columns()
    fixed_columns = fixed.trend.columns() if fixed else None
    scores = scores_of(config, session.table, session.commits, columns, fixed_columns)
    trend = write_trend(folder / TREND, session.trend, config.output.trend)
    write_whole(folder / GAINS, to_toml(session.table))
    data = ReportData(
        loop=config.loop.name,
        unit=config.loop.pv_unit,
        before=config.gain_table(),
        after=session.table,
        scores=scores,
        decisions=list(session.decisions),
        run=columns,
        fixed=fixed_columns,
        commits=[t for t, _ in session.commits],
        events=session.scenario.played,
        facts=_facts(job, ledger, trend.name) | ({"not restored": session.left_open} if session.left_open else {}),
        stopped=config.scenario is not None and not session.scenario.finished,
        advice=[one.sentence for one in advice_of(session)],
    )
    write_whole(folder / REPORT, render(data))
    _show(job, ledger, session, scores, screen, interrupted=interrupted)


def _show(
    job: _Job, ledger: Ledger, session: Session, scores: list[RegionScore], screen: LiveScreen, *, interrupted: bool
) -> None:
    """The result as a file, and for whoever asked for it."""
    folder = job.folder
    document = {**result(session, scores, ledger, folder), "interrupted": interrupted}
    write_json(folder / SUMMARY, document)
    if job.options.as_json:
        sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
        return
    unit = job.config.loop.pv_unit
    screen.pause()
    screen.table(scores_table(scores, unit), lambda: narrow_scores(scores, unit))
    done = f"{counted(len(session.decisions), 'decision')}, {counted(len(session.commits), 'change')} of gains"
    screen.say(f"{done}; report: {folder / REPORT}")
    screen.say(f"ledger head {ledger.head()}")
    _tell_what_next(job, ledger, session, screen)


def _tell_what_next(job: _Job, ledger: Ledger, session: Session, screen: LiveScreen) -> None:
    """What a person can do now."""
    names, trials = session.table.regions.names, session.retuner.trials
    locked = [name for i, name in enumerate(names) if trials.phase(i) is TrialPhase.LOCKED]
    approval_s, changed = job.config.adaptation.approval_s, bool(session.commits)
    for one in what_next(job.folder, ledger.rows(), approval_s, locked, changed=changed):
        screen.say(one.why)
        if one.command:
            screen.command(f"  {one.command}")


def advice_of(session: Session) -> tuple[RegionAdvice, ...]:
    """Whether regions should be split or merged, by what their records say."""
    retuner = session.retuner
    return region_advice(retuner.table.regions, retuner.region_models, retuner.settings.sample_time_s, AdviceSettings())


def _facts(job: _Job, ledger: Ledger, trend: str) -> dict[str, str]:
    """What a reader of the report needs to find the rest, or to do the run again."""
    config = job.config
    return {
        "retuner": version("retuner"),
        "Python": platform.python_version(),
        "bus": f"{config.bus.interface} {config.bus.channel}, node {config.bus.node}",
        "seed": str(config.device.seed) if config.device else "a real controller",
        "ledger": f"{LEDGER}, {ledger.verify().rows} rows, head {ledger.head()}",
        "trend": trend,
        "bus log": BUS_LOG,
        "gains": GAINS,
        "configuration": CONFIG,
    }


def result(session: Session, scores: list[RegionScore], ledger: Ledger, folder: Path) -> dict[str, object]:
    """The run as one JSON document: decisions, gains before and after per region, scores."""
    return {
        "loop": session.table.loop,
        "folder": str(folder),
        "decisions": [decision.to_dict() for decision in session.decisions],
        "gains": [
            {"region": name, **gains_dict(gains)}
            for name, gains in zip(session.table.regions.names, session.table.gains, strict=True)
        ],
        "scores": [score.to_dict() for score in scores],
        "advice": [one.to_dict() for one in advice_of(session)],
        "revision": session.table.revision,
        "ledger_head": ledger.head(),
    }
