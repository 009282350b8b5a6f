"""retuner run: watch and retune a loop, and leave report, ledger, trend and bus log behind."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from retuner.adaptive.supervision.decision import Mode
from retuner.commands.options import all_on_bus
from retuner.commands.work.foreseen import foreseen
from retuner.commands.work.run_job import RunJob
from retuner.commands.work.run_options import RunOptions
from retuner.config.loading import load_session
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig
from retuner.decision_page.shown_units import show_units_of
from retuner.decisions.proposed_schedule import ROW, refined, row_body, taken_up
from retuner.drivers.bus.bus_log import log_parts
from retuner.drivers.device import DeviceError
from retuner.errors import LedgerError, UserError
from retuner.files import write_whole
from retuner.ledger import Ledger, Recorder
from retuner.ledger.trend import require_writer
from retuner.products import product
from retuner.session.outputs import (
    BUS_LOG,
    CONFIG,
    LEDGER,
    REPORT,
    fresh_folder,
    give_back,
    log_of_bus,
)
from retuner.session.running import Run, nothing, real_time_speed
from retuner.session.session import Session
from retuner.session.session_identity import file_sha256, session_identity
from retuner.stopping import stoppable, unstoppable
from retuner.verbosity import quiet

if TYPE_CHECKING:
    from retuner.adaptive.region_model.refinement import Refinement
    from retuner.live_view.live_screen import LiveScreen
    from retuner.live_view.watching import Watching


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
    screen: LiveScreen = product("live view").screen_for(options.as_json, answers_only=quiet(), detail=options.verbose)
    require_writer(config.output.trend)
    if options.serve:
        product("page").require_page()
    fresh = fresh_folder(folder)
    try:
        with stoppable(), Ledger(folder / LEDGER) as ledger, screen:
            if fresh.moved:
                screen.say(f"the earlier run in {folder} was moved to {fresh.moved}")
            for warned in (one for loop in config.loops for one in foreseen(loop) if one.wrong):
                screen.say(f"warning: {warned.text}")
            return _run(RunJob(config, text, mode, speed, fresh, options), ledger, screen)
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
        raise UserError("pretune moves co, but mode off only watches: omit pretune, or give --mode advise")
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
        product("plants").plant_of(config)


class NothingHappenedError(Exception):
    """The run ended before the first sample: nothing is worth keeping. cause is what the user is told."""

    def __init__(self, cause: BaseException) -> None:
        self.cause = cause
        super().__init__(str(cause))


def _run(job: RunJob, ledger: Ledger, screen: "LiveScreen") -> int:
    """The run itself, the comparison run and what is left behind, also after Ctrl-C."""
    # Put the configuration as run into the folder, and what the run is made with into the ledger's first row
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
    watching: Watching = product("live view").Watching(screen, job.config, job.folder)
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
    if not job.options.serve:
        return _carried_out(job, job_run, ledger, watching, screen)
    with product("page").served_beside(job.folder, screen.say) as page:
        status = _carried_out(job, job_run, ledger, watching, screen)
        page.stay(watched=status == 0 and sys.stdout.isatty())
    return status


def _carried_out(job: RunJob, job_run: Run, ledger: Ledger, watching: "Watching", screen: "LiveScreen") -> int:
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
    again = Run(job.config, nothing, mode=Mode.OFF, observer=product("live view").OnScreen(screen, job.config))
    fixed = _unless_stopped(again, screen) if compare else None
    with unstoppable():
        proposed = [refined(loop.retuner) if loop.trend.rows else None for loop in session.loops]
        _close(job, ledger, session, proposed, interrupted=interrupted)
        interrupted |= compare and fixed is None
        left = product("what a run leaves")
        left.leave(job, ledger, session, fixed, proposed, screen, interrupted=interrupted)
    if wrong := [*_wrong(job, session), *job_run.stopped_plants]:
        raise UserError(*wrong)
    return 130 if interrupted else 0


def _wrong(job: RunJob, session: Session) -> Iterator[str]:
    """What a person must see to after the run, in a line each."""
    if told := session.frozen or session.left_open:
        yield f"{told}; the run was ended, and {job.folder / REPORT} says what the controller runs"
    yield from [*filter(None, (loop.wrong_way for loop in session.loops)), *job.unwritten.lines]
    if job.unwritten.lines:
        yield f"make room; the ledger has every decision: retuner report {job.folder} makes the report"


def _close(
    job: RunJob, ledger: Ledger, session: Session, proposed: "Sequence[Refinement | None]", *, interrupted: bool
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


def _traffic(job: RunJob) -> dict[str, object]:
    """The bus logs by name and by the hash of their parts one after the other."""
    logs = [log_of_bus(job.folder / BUS_LOG, number) for number in range(len(job.config.buses))]
    hashes = {log.name: file_sha256(*log_parts(log).paths) for log in logs}
    first: dict[str, object] = {"bus_log": BUS_LOG, "bus_log_sha256": hashes[BUS_LOG]}
    return first if len(logs) == 1 else {**first, "bus_logs": hashes}


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


def _keeper(ledger: Ledger, screen: "LiveScreen", most_mb: float) -> Recorder:
    """What keeps a run's rows. most_mb : size of the ledger past which that is told."""
    size = LedgerSize(ledger, most_mb, screen.say)

    def keep(kind: str, t_s: float, body: Mapping[str, object]) -> None:
        ledger.append(kind, body, t_s)
        size.look()

    return keep


def _play(job: RunJob, job_run: Run) -> tuple[Session, bool]:
    """The run to its end, or until it was stopped: what there is, and whether it was stopped."""
    try:
        return (job_run.simulated() if job.config.simulated else job_run.live(job.speed)), False
    except (KeyboardInterrupt, DeviceError) as stop:
        if job_run.session is None or not any(loop.trend.rows for loop in job_run.session.loops):
            raise NothingHappenedError(stop) from stop
        return job_run.session, True


def _unless_stopped(comparison: Run, screen: "LiveScreen") -> Session | None:
    """The comparison run, or None when the user stops it: the run that counts is over then, and is kept."""
    screen.begin("the same run with fixed gains")
    try:
        return comparison.simulated()
    except KeyboardInterrupt:
        return None
