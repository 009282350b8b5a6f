"""Running a session: on virtual devices in simulated time, or on whatever hangs on buses in real time.

    configuration of each loop -> device on its bus, retuner (with what it remembers), recorder, orders -> LoopSession

bench_or_buses.py says what the places are like; here the session is put together there, and driven to its end.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor
from retuner.adaptive.setpoint_bumps.bump_settings import BumpSettings
from retuner.adaptive.setpoint_bumps.loop_bumps import LoopBumps, hour_of_samples
from retuner.adaptive.supervision.decision import Mode
from retuner.config import Config
from retuner.config.foreign import UNPROVED_ORDER
from retuner.config.session_config import SessionConfig
from retuner.decisions.decider import DecideHere, Decider
from retuner.decisions.recorded_write_order import order_of_writes
from retuner.decisions.warm_up import warm_up
from retuner.decisions.worker import DecisionWorkers
from retuner.drivers.bus.link_settings import FramePort
from retuner.drivers.clock import Clock, MonotonicClock
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import OWNERS
from retuner.errors import LedgerError, UserError
from retuner.ledger import Recorder, Row
from retuner.products import product
from retuner.schedule.table import Lookup
from retuner.session.assembly import device_settings, make_device, make_retuner, retuner_settings
from retuner.session.bench_or_buses import POLLS_PER_SAMPLE, HostBuses, VirtualBench, before, live_buses, virtual_bench
from retuner.session.ledger_rows import bump_left
from retuner.session.loop_session import LoopSession
from retuner.session.memory_file import MemoryFile, NoMemoryError, recall
from retuner.session.order_queue import OrderDesk, left_before
from retuner.session.orders import OrderBox
from retuner.session.outputs import LEDGER, believed_rows, loop_folder, rows_by_loop
from retuner.session.scenario import ScenarioPlayer
from retuner.session.session import LoopRecorder, Observer, Session
from retuner.stopping import unstoppable

if TYPE_CHECKING:
    from retuner.session.pretuning import Pretuning


def nothing(kind: str, t_s: float, body: object) -> None:
    """A recorder that keeps nothing: for the comparison run."""
    del kind, t_s, body


def local_hour(t_s: float) -> float:
    """The hour of the day by this machine's clock."""
    del t_s
    now = datetime.now().astimezone()
    return now.hour + now.minute / 60 + now.second / 3600


def to_the_end(session: Session | LoopSession, once: Callable[[], None]) -> None:
    """Turn until the session is over. Ctrl-C lets it end: an undecided change is settled first; a second one does
    not wait for that (the controller's own trial time, or the next session, then does it). A defect of ours lets it end
    in the same way, before it is told.
    """
    try:
        while not session.finished:
            once()
    except BaseException as ending:
        if isinstance(ending, KeyboardInterrupt):
            session.stop("stopped by the user")
        else:
            session.fail(f"{type(ending).__name__}: {ending}")
        if session.seen:  # the turns that a session which was told to end still needs
            try:
                while not session.finished:
                    once()
            finally:
                session.tell_what_is_open()
        raise


class _RunningLoop:
    """One loop of a run, before and while it is watched.

    config : its. run : that it belongs to. folder : of the session, None where nothing is kept. before : that of the
    session which was there before. known : its rows about this loop, where they were read once for all.
    """

    def __init__(
        self, config: Config, run: "Run", folder: Path | None, before: Path | None, known: Sequence[Row] | None
    ) -> None:
        self.config, self._run = config, run
        self._name = name = config.loop.name if run.config.several else ""
        self._folder = loop_folder(folder, name) if folder is not None else None
        self._before, self._known = before, known
        self.record = LoopRecorder(run.keep, name, run.observer, run.ledger_failed)
        self.pretuning: Pretuning | None = None
        if config.adaptation.pretune:
            self.pretuning = product("pretune").Pretuning(config, self.record, self._say)
        self.session: LoopSession | None = None

    def begin(self, port: FramePort, decider: Decider, speed: float = 1.0, *, remember: bool = False) -> LoopSession:
        """The loop's session on its port. remember : go on with what was learned before, and keep what is learned."""
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
        # what the session before this one has learned, if it can be trusted; why not is said in a line
        remembered, why_not = None, ""
        if remember:
            settings = retuner_settings(self.config, self._run.mode)
            try:
                remembered = recall(self._before, self.config, settings, self._name, self._known)
            except NoMemoryError as none:
                why_not = str(none)
                if why_not:
                    self._say(why_not)
        device = make_device(self.config, port, speed, after_s=remembered.last_s if remembered is not None else None)
        retuner = remembered.retuner if remembered is not None else make_retuner(self.config, self._run.mode)
        player = ScenarioPlayer(self.config.scenario)
        session = LoopSession(device, retuner, player, self.record, self._run.observer.sampled, decider)
        self.session = self.record.loop = session
        foreign, units = self.config.foreign_device, retuner.settings.units
        if foreign is not None and units is not None and not isinstance(device, CanDevice):
            accepted = UNPROVED_ORDER in foreign.accept
            device.choose_way = order_of_writes(
                retuner, units, self.record, lambda: session.writer.t_s, unproved=accepted
            )
            if not accepted and retuner.table.lookup is Lookup.HARD:
                device.fits = lambda gains: any(change_factor(gains, one) <= SAME_GAINS for one in retuner.table.gains)
        hour_of = local_hour if remember and speed == 1.0 else hour_of_samples
        bumps = LoopBumps(BumpSettings(**self.config.adaptation.bumps.model_dump()), retuner, hour_of)

        def rows_before() -> Sequence[Row]:
            if self._known is not None or self._before is None:
                return self._known or ()
            path = self._before / LEDGER
            return believed_rows(path) if path.exists() else ()

        session.bumps = with_what_was_left(bumps, rows_before if remember else tuple, self._say)
        if remember and self._folder is not None:
            memory = MemoryFile(self._folder, self.config, self.record)
            memory.begin(remembered, why_not)
            session.remember = lambda t_s: memory.save(session.retuner, t_s)
        if self._folder is not None:
            session.orders = OrderDesk(
                OrderBox(self._folder),
                session.retuner,
                self.record,
                session.decisions,
                self.config.adaptation.approval_s,
                left_before(self._before, self._name, self._known),
            ).take
        if self.pretuning is not None:
            session.orders = self.pretuning.decisions(retuner, session.orders)
        return session

    def pretune(self, port: FramePort, clock: Clock, turn: Callable[[], None], speed: float = 1.0) -> None:
        """The commanded step before the session, on a link of its own."""
        if self.pretuning is None:
            return
        settings = device_settings(self.config, speed)
        device = make_device(self.config, port, speed, owner=settings.owner % OWNERS + 1)  # its lease counts by itself

        def turned() -> float:
            turn()
            return clock.now_s()

        try:
            self.pretuning.conduct(device, settings.silent_s, turned)
        finally:
            device.release(clock.now_s())

    def _say(self, text: str) -> None:
        self._run.observer.said(f"{self._name}: {text}" if self._name else text)


def with_what_was_left(
    bumps: LoopBumps, rows_before: Callable[[], Sequence[Row]], say: Callable[[str], None]
) -> LoopBumps | None:
    """Who bumps the setpoint, where that is allowed; a bump that the session before left out goes back first.

    Where it is not allowed nothing is sent, and say tells of a bump that was left out.
    """
    allowed = bumps.planner.settings.allowed
    try:
        left = bump_left(rows_before())
    except (LedgerError, KeyError, TypeError, ValueError) as error:
        if allowed:
            say(f"whether the session before left a setpoint bump is not known: {error}")
        left = None
    if left is not None and allowed:
        bumps.planner.resume_bumped(*left)
    elif left is not None:
        say(
            f"the session before left a setpoint bump out, from {left[0]:g} to {left[1]:g}, and bumps are no longer "
            "allowed: set the setpoint back by hand"
        )
    return bumps if allowed else None


class Run:
    """One run of a configuration.

    config : what to run, one loop or several. keep : the ledger. mode : overrides the configured one. log : file for
    the traffic of the first bus. observer : looks on. folder : of the session, where people put orders; before : that
    of the session which was there before and may have left some.
    """

    def __init__(
        self,
        config: Config | SessionConfig,
        keep: Recorder,
        *,
        mode: Mode | None = None,
        log: Path | None = None,
        observer: Observer | None = None,
        folder: Path | None = None,
        before: Path | None = None,
    ) -> None:
        self.config = SessionConfig((config,)) if isinstance(config, Config) else config
        self._keep, self.mode, self.observer = keep, mode, observer or Observer()
        self._keep_logs: Callable[[], None] = lambda: None
        self._log = log
        self.session: Session | None = None
        self.stopped_plants: Sequence[str] = ()
        self.ended_by = ""
        known: Mapping[str, Sequence[Row]] = {}
        if before is not None and self.config.several:
            with suppress(LedgerError):  # told by whoever wants to use it
                known = rows_by_loop(believed_rows(before / LEDGER), self.config.names)
        self._loops = [_RunningLoop(one, self, folder, before, known.get(one.loop.name)) for one in self.config.loops]

    def keep(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """Record a row; see Recorder."""
        self._keep(kind, t_s, body)
        self._keep_logs()

    def ledger_failed(self, reason: str) -> None:
        """The ledger takes no more rows: every loop comes to its end."""
        if self.session is not None:
            self.session.freeze(reason)

    def simulated(self) -> Session:
        """Run the whole scenario against the virtual devices in this process, as fast as it goes.

        Raises UserError, DeviceError: a loop has no [device], or the bus log cannot be opened.
        """
        with self.bench() as (session, bench):

            def once() -> None:
                bench.turn()
                with unstoppable():
                    self._faults(bench.buses)
                    session.poll(bench.clock.now_s())

            to_the_end(session, once)
            self.stopped_plants = bench.plants.stopped
            return session

    @contextmanager
    def bench(self) -> Iterator[tuple[Session, VirtualBench]]:
        """The session on a virtual bench, for whoever makes the turns himself."""

        def first(bench: VirtualBench) -> None:
            """The commanded steps: nobody may interrupt what devices and host share."""

            def turn() -> None:
                with unstoppable():
                    bench.turn()

            self._pretune(bench.buses, bench.clock, turn)

        with virtual_bench(self.config, self.observer.said, self._log, first if self._pretunes else None) as bench:
            deciders = [DecideHere(one.adaptation.decision_delay_samples) for one in self.config.loops]
            yield self._begin(bench.buses, deciders), bench

    def live(self, speed: float = 1.0) -> Session:
        """Run against whatever answers on the configured buses, until the scenarios are over or the user stops it.

        speed : how much faster than real time the far side's clock runs (a simulated plant on a bench).

        Raises DeviceError: a bus does not open, or nobody (or the wrong one) answers at first.
        """
        clock = MonotonicClock(speed)
        pause_s = min(one.loop.sample_time_s for one in self.config.loops) / POLLS_PER_SAMPLE
        if self._pretunes:
            with live_buses(self.config, speed, clock, before(self._log)) as buses:
                self._pretune(buses, clock, lambda: buses.wait_until(clock.now_s() + pause_s), speed)
        deadlines_s = [one.adaptation.decision_deadline_s for one in self.config.loops]
        with DecisionWorkers(len(deadlines_s)) as workers, live_buses(self.config, speed, clock, self._log) as buses:
            warm_up()  # entering a decision imports what making one does, and by then there are samples to take
            workers.wait_until_warm()
            session = self._begin(buses, [workers.decider(s) for s in deadlines_s], speed, remember=True)
            self._keep_logs = buses.keep_logs

            def once() -> None:
                with unstoppable():
                    session.poll(clock.now_s(), buses.heard(), clock.now_s)
                    self._faults(buses)
                buses.wait_until(clock.now_s() + pause_s)

            try:
                to_the_end(session, once)
            finally:
                session.release(clock.now_s())
            return session

    def _begin(
        self, buses: HostBuses, deciders: Sequence[Decider], speed: float = 1.0, *, remember: bool = False
    ) -> Session:
        loops = [
            loop.begin(buses.port(i), decider, speed, remember=remember)
            for i, (loop, decider) in enumerate(zip(self._loops, deciders, strict=True))
        ]
        if self.config.several:
            product("one plant").join(self.config.loops, loops)
        buses.keep_leases([loop.device for loop in loops])
        self.session = Session(loops, self.observer.said)
        return self.session

    def _pretune(self, buses: HostBuses, clock: Clock, turn: Callable[[], None], speed: float = 1.0) -> None:
        for i, loop in enumerate(self._loops):
            loop.pretune(buses.port(i), clock, turn, speed)

    @property
    def _pretunes(self) -> bool:
        return any(loop.pretuning for loop in self._loops)

    def _faults(self, buses: HostBuses) -> None:
        assert self.session is not None
        for i, news in buses.news():
            self.session.loops[i].link_faults(news)


# --speed: simulated time, or how much faster than real time the far side of a bus runs.


def real_time_speed(text: str, *, simulated: bool) -> float:
    """--speed as a number: "max" is simulated time; a number is how much faster than real time the far side runs.

    Raises UserError: neither "max" nor a positive number, or "max" for a bus that leaves this process.
    """
    if text == "max":
        return 1.0
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise UserError(f"--speed {text}: give max, or a positive number (1 is real time)")
    if simulated:
        raise UserError(
            "--speed: the virtual bus runs in simulated time as fast as it goes; leave the option out, or "
            "give --interface of a bus on which `retuner device` runs"
        )
    return speed
