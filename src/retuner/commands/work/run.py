"""retuner run: watch and retune a loop, and leave report, ledger, trend and bus log behind."""

import json
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from retuner.adaptive.region_model.refinement import Refinement
from retuner.adaptive.region_model.region_advice import AdviceSettings, RegionAdvice, region_advice
from retuner.adaptive.supervision.decision import Mode, gains_dict
from retuner.adaptive.trial.phase import TrialPhase
from retuner.commands.options import all_on_bus
from retuner.commands.work.foreseen import foreseen
from retuner.commands.work.report import scores_of
from retuner.commands.work.run_options import RunOptions
from retuner.config.bench_plants import plant_of
from retuner.config.loading import load_session
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig
from retuner.decision_page.shown_units import show_units_of
from retuner.decisions.proposed_schedule import ROW, refined, row_body, taken_up
from retuner.drivers.bus.bus_log import log_parts
from retuner.drivers.device import DeviceError
from retuner.errors import LedgerError, UserError
from retuner.files import Unwritten, write_json, write_whole
from retuner.ledger import Ledger, Recorder
from retuner.ledger.trend import require_writer, write_trend
from retuner.live_view.live_screen import LiveScreen
from retuner.live_view.watching import OnScreen, Watching
from retuner.live_view.what_next import Changed, narrow_scores, what_next
from retuner.report.console import counted, scores_table, screen_console
from retuner.report.loops_index import LoopLine, loop_line, render_index
from retuner.report.report import ReportData, render
from retuner.report.scores import RegionScore
from retuner.schedule.config_section import schedule_section
from retuner.schedule.document import to_toml
from retuner.serve.beside import require_page, served_beside
from retuner.session.loop_session import LoopSession
from retuner.session.outputs import (
    BUS_LOG,
    CONFIG,
    GAINS,
    LEDGER,
    LOOPS,
    REFINED,
    REFINED_SCHEDULE,
    REPORT,
    SUMMARY,
    TREND,
    FreshFolder,
    fresh_folder,
    give_back,
    log_of_bus,
    loop_folder,
)
from retuner.session.recorded_session import rows_by_loop
from retuner.session.running import Run, nothing, real_time_speed
from retuner.session.session import Session
from retuner.session.session_identity import file_sha256, session_identity
from retuner.stopping import stoppable, unstoppable
from retuner.verbosity import quiet


def run(options: RunOptions) -> int:
    """Run a configuration; the exit status.

    Raises
    ------
    ConfigError, UserError, DeviceError
        The configuration, the options, the folder or the bus cannot be used, one line each.
    """
    read, text = load_session(options.config)
    config = all_on_bus(read, options.interface, options.channel)
    show_units_of(config)
    if options.pretune:
        config = replace(config, loops=tuple(_pretuned(one) for one in config.loops))
    mode = _mode_of(options, config)
    if config.simulated:
        _look_at_benches(options.config, config)
    speed = real_time_speed(options.speed, simulated=config.simulated)
    folder = options.out or Path(config.output.directory)
    console = screen_console(stderr=options.as_json)
    screen = LiveScreen(console, quiet=options.as_json, answers_only=quiet(), detail=options.verbose)
    require_writer(config.output.trend)
    require_page(wanted=options.serve)
    fresh = fresh_folder(folder)
    try:
        with stoppable(), Ledger(folder / LEDGER) as ledger, screen:
            if fresh.moved:
                screen.say(f"the earlier run in {folder} was moved to {fresh.moved}")
            for warned in (one for loop in config.loops for one in foreseen(loop) if one.wrong):
                screen.say(f"warning: {warned.text}")
            return _run(_Job(config, text, mode, speed, fresh, options), ledger, screen)
    except NothingHappenedError as nothing_happened:
        give_back(fresh)
        raise nothing_happened.cause from None
    except LedgerError:  # it could not be opened
        give_back(fresh)
        raise


def _mode_of(options: RunOptions, session: SessionConfig) -> Mode | None:
    """The mode for all loops, None for that of each; refuses to move co where nothing but watching is allowed."""
    if options.mode is not None and options.mode not in set(Mode):
        raise UserError(f"--mode {options.mode}: give one of {', '.join(Mode)}")
    mode = Mode(options.mode) if options.mode else None
    if any(one.adaptation.pretune and (mode or one.adaptation.mode) == Mode.OFF for one in session.loops):
        raise UserError("pretune moves co, and mode off only watches: leave pretune out, or give --mode advise")
    return mode


def _pretuned(config: Config) -> Config:
    """A loop's configuration with a step of co at the beginning."""
    return config.model_copy(update={"adaptation": config.adaptation.model_copy(update={"pretune": True})})


def _look_at_benches(path: Path, session: SessionConfig) -> None:
    """Refuse a simulated run that has nothing to run on, or no end."""
    for config in session.loops:
        whose = f"loop {config.loop.name}: " * session.several
        if config.scenario is None:
            raise UserError(f"{path}: {whose}a simulated run needs a [scenario] with its length and steps; add one")
        plant_of(config)


class NothingHappenedError(Exception):
    """The run ended before the first sample: nothing is worth keeping. cause is what the user is told."""

    def __init__(self, cause: BaseException) -> None:
        self.cause = cause
        super().__init__(str(cause))


@dataclass(frozen=True, slots=True)
class _Job:
    """Everything that is settled before a run begins. text : the configuration as its author wrote it. unwritten :
    what the system refuses of what the run leaves.
    """

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
        return f"{counted(len(self.config.loops), 'loop')}" if self.config.several else f"{first.loop.name}: {mode}"


def _run(job: _Job, ledger: Ledger, screen: LiveScreen) -> int:
    """The run itself, the comparison run and what is left behind, also after Ctrl-C."""
    _open_session(job, ledger)
    watching = Watching(screen, job.config, job.folder)
    job_run = Run(
        job.config,
        _keeper(ledger, screen, job.config.output.ledger_mb_warn),
        mode=job.mode,
        log=job.folder / BUS_LOG,
        observer=watching,
        folder=job.folder,
        before=job.fresh.moved,
    )
    screen.begin(job.title)
    with served_beside(job.folder, screen.say, wanted=job.options.serve) as page:
        status = _carried_out(job, job_run, ledger, watching, screen)
        page.stay(watched=status == 0 and sys.stdout.isatty())
    return status


def _carried_out(job: _Job, job_run: Run, ledger: Ledger, watching: Watching, screen: LiveScreen) -> int:
    """The run to its end, and all that it leaves; its exit status.

    Raises
    ------
    UserError
        It ended with gains that nobody meant.
    """
    try:
        session, interrupted = _play(job, job_run)
    finally:
        watching.close()
    compare = job.config.simulated and job.options.compare and not interrupted
    again = Run(job.config, nothing, mode=Mode.OFF, observer=OnScreen(screen, job.config))
    fixed = _unless_stopped(again, screen) if compare else None
    with unstoppable():
        proposed = [refined(loop.retuner) if loop.trend.rows else None for loop in session.loops]
        _close(job, ledger, session, proposed, interrupted=interrupted)
        interrupted |= compare and fixed is None
        _leave(job, ledger, session, fixed, proposed, screen, interrupted=interrupted)
    if wrong := [*_wrong(job, session), *job_run.stopped_plants]:
        raise UserError(*wrong)
    return 130 if interrupted else 0


def _wrong(job: _Job, session: Session) -> Iterator[str]:
    """What a person must see to after the run, in a line each."""
    if told := session.frozen or session.left_open:
        yield f"{told}; the run was ended, and {job.folder / REPORT} says what the controller runs"
    yield from [*filter(None, (loop.wrong_way for loop in session.loops)), *job.unwritten.lines]
    if job.unwritten.lines:
        yield f"make room; the ledger has every decision: retuner report {job.folder} makes the report"


def _close(
    job: _Job, ledger: Ledger, session: Session, proposed: Sequence[Refinement | None], *, interrupted: bool
) -> None:
    """The rows that end the session; before them another schedule for each loop whose records ask for one, and those
    that end its loops where there are several.
    """
    several, samples = job.config.several, sum(loop.samples for loop in session.loops)
    try:
        for loop, other in zip(session.loops, proposed, strict=True):
            if other is not None:
                ledger.append(ROW, row_body(other, loop.samples, loop.name if several else ""), loop.writer.t_s)
        if several:
            for loop in session.loops:
                loop.tell_over()
        ledger.append("end", {"interrupted": interrupted, **_traffic(job), "samples": samples}, session.t_s)
    except LedgerError as error:
        session.freeze(str(error))


def _traffic(job: _Job) -> dict[str, object]:
    """The bus logs by name and by the hash of their parts one after the other."""
    logs = [log_of_bus(job.folder / BUS_LOG, number) for number in range(len(job.config.buses))]
    hashes = {log.name: file_sha256(*log_parts(log).paths) for log in logs}
    first: dict[str, object] = {"bus_log": BUS_LOG, "bus_log_sha256": hashes[BUS_LOG]}
    return first if len(logs) == 1 else {**first, "bus_logs": hashes}


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
    schedules = taken_up(job.config.loops)
    body = {"config": job.config.summary(), "retuner": version("retuner"), **identity, "samples": 0}
    body |= {"schedules": schedules} if schedules else {}
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


def _keeper(ledger: Ledger, screen: LiveScreen, most_mb: float) -> Recorder:
    """What keeps a run's rows. most_mb : size of the ledger past which that is told."""
    size = LedgerSize(ledger, most_mb, screen.say)

    def keep(kind: str, t_s: float, body: Mapping[str, object]) -> None:
        ledger.append(kind, body, t_s)
        size.look()

    return keep


def _play(job: _Job, job_run: Run) -> tuple[Session, bool]:
    """The run to its end, or until it was stopped: what there is, and whether it was stopped."""
    try:
        return (job_run.simulated() if job.config.simulated else job_run.live(job.speed)), False
    except (KeyboardInterrupt, DeviceError) as stop:
        if job_run.session is None or not any(loop.trend.rows for loop in job_run.session.loops):
            raise NothingHappenedError(stop) from stop
        return job_run.session, True


def _unless_stopped(comparison: Run, screen: LiveScreen) -> Session | None:
    """The comparison run, or None when the user stops it: the run that counts is over then, and is kept."""
    screen.begin("the same run with fixed gains")
    try:
        return comparison.simulated()
    except KeyboardInterrupt:
        return None


def _leave(
    job: _Job,
    ledger: Ledger,
    session: Session,
    fixed: Session | None,
    proposed: Sequence[Refinement | None],
    screen: LiveScreen,
    *,
    interrupted: bool,
) -> None:
    """Write everything that the run leaves, and show the result. proposed : another schedule, by loop."""
    left = [
        _leave_loop(job, ledger, session, i, fixed.loops[i] if fixed else None, proposed[i])
        for i, loop in enumerate(session.loops)
        if loop.trend.rows
    ]
    if job.config.several:
        job.unwritten.write(job.folder / REPORT, render_index(_index_lines(session, left), _facts(job, ledger, LOOPS)))
    _show(job, ledger, session, left, screen, interrupted=interrupted)


class _Left(NamedTuple):
    """What a run leaves of one loop. report : below the session's folder. advice : on its regions."""

    loop: LoopSession
    unit: str
    scores: list[RegionScore]
    report: Path
    advice: Sequence[RegionAdvice | Refinement]


def _leave_loop(
    job: _Job, ledger: Ledger, session: Session, i: int, fixed: LoopSession | None, other: Refinement | None
) -> _Left:
    """What the run leaves of one loop, in the folder of the loop. other : the schedule that its records ask for."""
    config, loop = job.config.loops[i], session.loops[i]
    folder = loop_folder(job.folder, loop.name if job.config.several else "")
    columns = loop.trend.columns()
    fixed_columns = fixed.trend.columns() if fixed is not None and fixed.trend.rows else None
    scores = scores_of(config, loop.table, loop.commits, columns, fixed_columns)
    job.unwritten.write(folder / GAINS, to_toml(loop.table))
    advice, kind = advice_of(loop, other), config.output.trend
    with job.unwritten.trying():
        write_trend(folder / TREND, loop.trend, kind)
    _write_refined(job, other, folder, loop.name if job.config.several else "")
    data = ReportData(
        loop=config.loop.name,
        unit=config.loop.pv_unit,
        before=config.gain_table(),
        after=loop.table,
        scores=scores,
        decisions=list(loop.decisions),
        run=columns,
        fixed=fixed_columns,
        commits=[t for t, _ in loop.commits],
        events=loop.scenario.played,
        facts=_facts(job, ledger, f"{TREND}.{kind}", i) | ({"not restored": loop.left_open} if loop.left_open else {}),
        stopped=config.scenario is not None and not loop.scenario.finished,
        advice=[one.sentence for one in advice],
        ms_limit=config.adaptation.ms_marked,
    )
    job.unwritten.write(folder / REPORT, render(data))
    return _Left(loop, config.loop.pv_unit, scores, (folder / REPORT).relative_to(job.folder), advice)


def _index_lines(session: Session, left: Sequence[_Left]) -> list[LoopLine]:
    """A line for each loop of the session."""
    reports = {one.loop.name: str(one.report) for one in left}
    scores = {one.loop.name: one.scores for one in left}
    return [
        loop_line(
            loop.name,
            reports.get(loop.name),
            [decision.to_dict() for decision in loop.decisions],
            scores.get(loop.name, []),
            session.absent.get(loop.name, loop.left_open),
        )
        for loop in session.loops
    ]


def _show(
    job: _Job, ledger: Ledger, session: Session, left: Sequence[_Left], screen: LiveScreen, *, interrupted: bool
) -> None:
    """The result as a file, and for whoever asked for it."""
    folder, several = job.folder, job.config.several
    results = [result(one, ledger, folder / one.report.parent) for one in left]
    whole = {"folder": str(folder), "loops": results, "absent": session.absent, "ledger_head": ledger.head()}
    document = {**(whole if several else results[0]), "interrupted": interrupted}
    with job.unwritten.trying():
        write_json(folder / SUMMARY, document)
    if job.options.as_json:
        sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
        return
    screen.pause()
    for one in left:
        name = one.loop.name if several else ""
        limit = job.config.loops[job.config.names.index(one.loop.name)].adaptation.ms_marked
        screen.table(
            scores_table(one.scores, one.unit, name, limit), partial(narrow_scores, one.scores, one.unit, name)
        )
    decisions = sum(len(loop.decisions) for loop in session.loops)
    changes = sum(len(loop.commits) for loop in session.loops)
    done = f"{counted(decisions, 'decision')}, {counted(changes, 'change')} of gains"
    screen.say(f"{done}; report: {folder / REPORT}")
    screen.say(f"ledger head {ledger.head()}")
    _tell_what_next(job, ledger, left, screen)


def _tell_what_next(job: _Job, ledger: Ledger, left: Sequence[_Left], screen: LiveScreen) -> None:
    """What a person can do now."""
    several = job.config.several
    about = rows_by_loop(ledger.rows(), job.config.names)
    for one in left:
        loop, name = one.loop, one.loop.name
        names = loop.table.regions.names
        locked = [region for i, region in enumerate(names) if loop.retuner.trials.phase(i) is TrialPhase.LOCKED]
        table = job.folder / one.report.parent / GAINS
        changed = Changed(table, job.options.config) if loop.commits else None
        approval_s = job.config.loops[job.config.names.index(name)].adaptation.approval_s
        for told in what_next(job.folder, about[name], approval_s, locked, changed, name if several else ""):
            screen.say(told.why)
            if told.command:
                screen.command(f"  {told.command}")


def advice_of(loop: LoopSession, other: Refinement | None) -> tuple[RegionAdvice | Refinement, ...]:
    """Whether regions should be split or merged, or the schedule be another, by what their records say."""
    retuner = loop.retuner
    regions, models, dt_s = retuner.table.regions, retuner.region_models, retuner.settings.sample_time_s
    advice = region_advice(regions, models, dt_s, AdviceSettings())
    return (*advice, other) if other is not None else advice


def _write_refined(job: _Job, other: Refinement | None, folder: Path, loop: str) -> None:
    """The proposed schedule as files that a person may take up. loop : its name where it is one of several."""
    if other is not None:
        job.unwritten.write(folder / REFINED, to_toml(other.table))
        job.unwritten.write(folder / REFINED_SCHEDULE, schedule_section(other.table, loop))


def _facts(job: _Job, ledger: Ledger, trend: str, i: int | None = None) -> dict[str, str]:
    """What a reader of the report needs to find the rest, or to do the run again. i : of which loop, None for all."""
    loops = job.config.loops if i is None else (job.config.loops[i],)
    buses = {f"{one.bus.interface} {one.bus.channel}, node {one.node}": None for one in loops}
    seeds = [str(one.device.seed) if one.device else "a real controller" for one in loops]
    return {
        "retuner": version("retuner"),
        "Python": platform.python_version(),
        "bus": "; ".join(buses),
        "seed": ", ".join(dict.fromkeys(seeds)),
        "ledger": f"{LEDGER}, {ledger.verify().rows} rows, head {ledger.head()}",
        "trend": trend,
        "bus log": BUS_LOG,
        "gains": GAINS,
        "configuration": CONFIG,
    }


def result(left: _Left, ledger: Ledger, folder: Path) -> dict[str, object]:
    """The run of a loop as one JSON document: decisions, gains before and after per region, scores."""
    loop = left.loop
    return {
        "loop": loop.name,
        "folder": str(folder),
        "decisions": [decision.to_dict() for decision in loop.decisions],
        "gains": [
            {"region": name, **gains_dict(gains)}
            for name, gains in zip(loop.table.regions.names, loop.table.gains, strict=True)
        ],
        "scores": [score.to_dict() for score in left.scores],
        "advice": [one.to_dict() for one in left.advice],
        "revision": loop.table.revision,
        "ledger_head": ledger.head(),
    }
