"""retuner run: watch and retune a loop, and leave report, ledger, trend and bus log behind."""

import importlib.util
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from retuner.adaptive.supervision.decision import Mode
from retuner.commands.options import all_on_bus
from retuner.config.loading import load_session
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig
from retuner.decision_page.shown_units import show_units_of
from retuner.decisions.proposed_schedule import ROW, refined, row_body, taken_up
from retuner.drivers.bus.bus_opening import log_parts
from retuner.drivers.device import DeviceError
from retuner.errors import LedgerError, UserError
from retuner.files import Unwritten, write_whole
from retuner.ledger import Ledger
from retuner.ledger.trend import NO_PYARROW
from retuner.products import product
from retuner.schedule.controller_units import Acting
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.table import Lookup
from retuner.session import outputs
from retuner.session.assembly import guard_settings
from retuner.session.running import Run, nothing, real_time_speed
from retuner.session.session import Session
from retuner.stopping import stoppable, unstoppable
from retuner.verbosity import quiet

if TYPE_CHECKING:  # the run itself is called with them
    from retuner.commands.signatures import RunOptions
    from retuner.live_view.live_screen import LiveScreen
    from retuner.live_view.watching_session import Watching


# ---- Everything that is settled before a run begins


@dataclass(frozen=True, slots=True)
class RunJob:
    """text : the configuration as its author wrote it. unwritten : what the system refuses of what the run leaves."""

    config: SessionConfig
    text: str
    mode: Mode | None
    speed: float
    fresh: outputs.FreshFolder
    options: "RunOptions"
    unwritten: Unwritten = field(default_factory=Unwritten)

    @property
    def folder(self) -> Path:
        """Where the run leaves everything."""
        return self.fresh.path


# ---- What can be foreseen of a configuration that is well formed: gains of the wrong sign, limits that stand in
# the way.
#
# The sign is compared where the plant is known, which is a simulated one. Limits are compared with the gains in the
# file, and with the first setpoint step whose proportional action alone is more than the output has room for.


class Warned(NamedTuple):
    """One thing foreseen. wrong : it cannot work, not only in the way."""

    text: str
    wrong: bool = False


def foreseen(config: Config) -> Iterator[Warned]:
    """Everything that can be foreseen, the worst first."""
    regions = config.regions()
    axis = regions.axes[0]
    by_pv = axis.variable in {"sp", "pv"}
    # Gains of the wrong sign for a plant that is known
    plant = product("plants").known_plant(config) if config.device and config.device.plant else None
    if plant is not None:
        for i, gains in enumerate(config.gains()):
            k = plant.linearise(regions.centre(i) if by_pv else (config.loop.pv_min + config.loop.pv_max) / 2).k
            if math.copysign(1, k) == gains.direction:
                continue
            falls, needed = ("falls", Acting.DIRECT) if k < 0 else ("rises", Acting.REVERSE)
            yield Warned(
                f"region {regions.names[i]}: the plant's pv {falls} when the output rises, which needs a "
                f"{needed}-acting controller; these gains are {Acting.of(gains)} acting: change their sign, or "
                "[loop] action",
                wrong=True,
            )
    # Gains in the file that stand beyond the limits of changes already
    limits = guard_settings(config)
    for name, gains in zip(regions.names, config.gains(), strict=True):
        tau_i_s = gains.kp / gains.ki if gains.ki else None
        for what, value, least, most in (
            ("kc", abs(gains.kp), limits.kc_min, limits.kc_max),
            ("tau_i", tau_i_s, limits.tau_i_min_s, limits.tau_i_max_s),
            ("tau_d", gains.kd / gains.kp if gains.kp else 0.0, 0.0, limits.tau_d_max_s),
        ):
            if value is None or least <= value <= most:
                continue
            side, limit = ("below", least) if value < least else ("above", most)
            yield Warned(
                f"region {name}: {what} = {value:g} (parallel form) is {side} the limit of [adaptation], {limit:g}: "
                "changes may only lead towards it"
            )
    # Boundaries on what is measured, over which its noise alone takes the loop to and fro
    hard = Lookup(config.schedule.lookup) is Lookup.HARD
    for one in regions.axes:
        if hard and one.bounds and one.variable != "sp" and not (one.hysteresis or one.min_stay_s):
            yield Warned(
                f"the gains follow {one.label}, which has noise, over boundaries without hysteresis: at one of them "
                "gains are written at every change of side; give hysteresis (more than the noise) or min_stay_s"
            )
    # The first step of the setpoint that moves co further than it can
    room = config.loop.co_max_pct - config.loop.co_min_pct
    steps = config.scenario.steps if config.scenario is not None else []
    for (_, before), (at_s, after) in pairwise((one.at_s, one.sp) for one in steps if one.sp is not None):
        alone = by_pv and len(regions.axes) == 1
        gains = config.gains()[sum(bound <= after for bound in axis.bounds) if alone else 0]
        kick = abs(config.loop.b * gains.kp * (after - before))
        if kick > room:
            yield Warned(
                f"scenario: the step of sp from {before:g} to {after:g} at {at_s:g} s moves the output by {kick:.0f} % "
                f"at once; its range is {room:g} %, so it will hit its limit, which hides the response"
            )
            return


# ---- retuner run


def run(options: "RunOptions") -> int:
    """Run a configuration; the exit status.

    Raises ConfigError, UserError, DeviceError: the configuration, the options, the folder or the bus cannot be used,
    one line each.
    """
    read, text = load_session(options.config)
    config = all_on_bus(read, options.interface, options.channel)
    show_units_of(config)
    if options.pretune:
        own = [one.adaptation.model_copy(update={"pretune": True}) for one in config.loops]
        loops = (one.model_copy(update={"adaptation": more}) for one, more in zip(config.loops, own, strict=True))
        config = replace(config, loops=tuple(loops))
    # the mode for all loops, None for that of each; refuses to move co where nothing but watching is allowed
    if options.mode is not None and options.mode not in set(Mode):
        raise UserError(f"--mode {options.mode}: give one of {', '.join(Mode)}")
    mode = Mode(options.mode) if options.mode else None
    if any(one.adaptation.pretune and (mode or one.adaptation.mode) == Mode.OFF for one in config.loops):
        raise UserError("pretune moves co, but mode off only watches: omit pretune, or give --mode advise")
    if config.simulated:
        for one in config.loops:  # something to run on, and an end
            whose = f"loop {one.loop.name}: " * config.several
            if one.scenario is None:
                raise UserError(
                    f"{options.config}: {whose}a simulated run needs a [scenario] with its length and steps; add one"
                )
            product("plants").plant_of(one)
    speed = real_time_speed(options.speed, simulated=config.simulated)
    folder = options.out or Path(config.output.directory)
    screen: LiveScreen = product("live view").screen_for(options.as_json, answers_only=quiet(), detail=options.verbose)
    if config.output.trend == "parquet" and importlib.util.find_spec("pyarrow") is None:
        raise UserError(NO_PYARROW)
    if options.serve:
        product("page").require_page()
    fresh = outputs.fresh_folder(folder)
    try:
        with stoppable(), Ledger(folder / outputs.LEDGER) as ledger, screen:
            if fresh.moved:
                screen.say(f"the earlier run in {folder} was moved to {fresh.moved}")
            for warned in (one for loop in config.loops for one in foreseen(loop) if one.wrong):
                screen.say(f"warning: {warned.text}")
            return _run(RunJob(config, text, mode, speed, fresh, options), ledger, screen)
    except NothingHappenedError as nothing_happened:
        outputs.give_back(fresh)
        raise nothing_happened.cause from None
    except LedgerError:  # it could not be opened
        outputs.give_back(fresh)
        raise


class NothingHappenedError(Exception):
    """The run ended before the first sample: nothing is worth keeping. cause is what the user is told."""

    def __init__(self, cause: BaseException) -> None:
        self.cause = cause
        super().__init__(str(cause))


def _run(job: RunJob, ledger: Ledger, screen: "LiveScreen") -> int:
    # Put the configuration as run into the folder, and what the run is made with into the ledger's first row
    options = job.options
    named = {
        ("adaptation", "mode"): options.mode,
        ("bus", "interface"): options.interface,
        ("bus", "channel"): options.channel,
        ("adaptation", "pretune"): options.pretune or None,
    }
    changes = {place: value for place, value in named.items() if value is not None}
    text, identity = outputs.session_identity(job.config, job.text, changes)
    schedules = taken_up(job.config.loops)
    body = {"config": job.config.summary(), "retuner": version("retuner"), **identity, "samples": 0}
    body |= {"schedules": schedules} if schedules else {}
    try:
        write_whole(job.folder / outputs.CONFIG, text)
        ledger.append("session", body, 0.0)
    except (LedgerError, OSError) as error:
        raise NothingHappenedError(error) from error
    watching: Watching = product("live view").Watching(screen, job.config, job.folder)
    look = size_watch(ledger, job.config.output.ledger_mb_warn, screen.say)

    def keep(kind: str, t_s: float, body: Mapping[str, object]) -> None:
        ledger.append(kind, body, t_s)
        look()

    job_run = Run(
        job.config,
        keep,
        mode=job.mode,
        log=job.folder / outputs.BUS_LOG,
        observer=watching,
        folder=job.folder,
        before=job.fresh.moved,
    )
    first = job.config.loops[0]
    alone = f"{first.loop.name}: {job.mode or first.adaptation.mode}"
    screen.begin(f"{len(job.config.loops)} loops" if job.config.several else alone)
    if not job.options.serve:
        return _carried_out(job, job_run, ledger, watching, screen)
    with product("page").served_beside(job.folder, screen.say) as stay:
        status = _carried_out(job, job_run, ledger, watching, screen)
        if status == 0 and sys.stdout.isatty():  # a person sits there to end it
            stay()
    return status


def _carried_out(job: RunJob, job_run: Run, ledger: Ledger, watching: "Watching", screen: "LiveScreen") -> int:
    """The run to its end, and all that it leaves; its exit status.

    Raises UserError: it ended with gains that nobody meant.
    """
    try:
        session, interrupted = _play(job, job_run)
    finally:
        watching.close()
    compare = job.config.simulated and job.options.compare and not interrupted
    fixed: Session | None = None
    if compare:
        screen.begin("the same run with fixed gains")
        again = Run(job.config, nothing, mode=Mode.OFF, observer=product("live view").OnScreen(screen, job.config))
        with suppress(KeyboardInterrupt):  # the run that counts is over then, and is kept
            fixed = again.simulated()
    with unstoppable():
        proposed = [refined(loop.retuner) if loop.trend.rows else None for loop in session.loops]
        # the rows that end the session; before them another schedule for each loop whose records ask for one, and
        # those that end its loops where there are several
        several, samples = job.config.several, sum(loop.samples for loop in session.loops)
        try:
            for loop, other in zip(session.loops, proposed, strict=True):
                if other is not None:
                    ledger.append(ROW, row_body(other, loop.samples, loop.name if several else ""), loop.writer.t_s)
            if several:
                for loop in session.loops:
                    loop.tell_over()
            logs = [outputs.log_of_bus(job.folder / outputs.BUS_LOG, number) for number in range(len(job.config.buses))]
            hashes = {log.name: outputs.file_sha256(*log_parts(log).paths) for log in logs}
            first: dict[str, object] = {"bus_log": outputs.BUS_LOG, "bus_log_sha256": hashes[outputs.BUS_LOG]}
            traffic = first if len(logs) == 1 else {**first, "bus_logs": hashes}
            ledger.append("end", {"interrupted": interrupted, **traffic, "samples": samples}, session.t_s)
        except LedgerError as error:
            session.freeze(str(error))
        interrupted |= compare and fixed is None
        product("what a run leaves").leave(job, ledger, session, fixed, proposed, screen, interrupted=interrupted)
    # what a person must see to, in a line each
    wrong = [loop.wrong_way for loop in session.loops if loop.wrong_way]
    if told := session.frozen or session.left_open:
        wrong.insert(0, f"{told}; the run was ended, and {job.folder / outputs.REPORT} says what the controller runs")
    if job.unwritten.lines:
        room = f"make room; the ledger has every decision: retuner report {job.folder} makes the report"
        wrong += [*job.unwritten.lines, room]
    wrong += [*job_run.stopped_plants, *filter(None, [job_run.ended_by])]
    if wrong:
        raise UserError(*wrong)
    return 130 if interrupted else 0


def size_watch(ledger: Ledger, most_mb: float, say: Callable[[str], None]) -> Callable[[], None]:
    """A look at a ledger's size, for after each row: that it has grown past most_mb is said once. It is never cut,
    because it is the record of what was decided.
    """
    told = False

    def look() -> None:
        nonlocal told
        if not told and ledger.size_bytes() > most_mb * 1e6:
            told = True
            say(
                f"{ledger.path}: has grown past {most_mb:g} MB ([output] ledger_mb_warn) and is never cut; "
                "when the disk is short, end this run and begin another, which starts a new ledger"
            )

    return look


def _play(job: RunJob, job_run: Run) -> tuple[Session, bool]:
    try:
        return (job_run.simulated() if job.config.simulated else job_run.live(job.speed)), False
    except (KeyboardInterrupt, DeviceError) as stop:
        if job_run.session is None or not any(loop.trend.rows for loop in job_run.session.loops):
            raise NothingHappenedError(stop) from stop
        if isinstance(stop, DeviceError):
            job_run.ended_by = str(stop)
        return job_run.session, True
