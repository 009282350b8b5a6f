"""Running a session: on a virtual device in simulated time, or on whatever hangs on a bus in real time.

In simulated time device and host take turns on python-can's `virtual` bus in one thread: the device makes a sample, the
host takes it in and answers, the device takes the answers in before its next sample. Nothing waits and nothing races,
so the same seed gives the same bytes.
"""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import can

from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Mode
from retuner.config import Config
from retuner.decisions.decider import DecideHere, Decider
from retuner.decisions.worker import DecideInWorker
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.clock import Clock, MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.host.can_settings import OWNERS
from retuner.errors import UserError
from retuner.ledger import Recorder
from retuner.session.assembly import (
    device_settings,
    link_settings,
    make_retuner,
    retuner_settings,
)
from retuner.session.devices import make_device, make_far_side, prove_order
from retuner.session.memory_file import MemoryFile, NoMemoryError, Remembered, recall
from retuner.session.order_queue import OrderDesk, left_before
from retuner.session.orders import OrderBox
from retuner.session.pretuning import LOG_PREFIX, Pretuning
from retuner.session.scenario import ScenarioPlayer
from retuner.session.session import Session
from retuner.stopping import unstoppable

POLLS_PER_SAMPLE = 4
"""In real time the host looks at least this often per sample, even when no frame wakes it."""
_channels = itertools.count()
FirstTurns = Callable[[CanLink, SimulatedClock, Callable[[], None]], None]
"""What is done on a virtual bench before the host: it is given a link, the clock, and a turn of the device."""


def nothing(kind: str, t_s: float, body: object) -> None:
    """A recorder that keeps nothing: for the comparison run."""
    del kind, t_s, body


class BenchLink(CanLink):
    """The host's end of a bench in simulated time, on which a foreign controller answers at once, as firmware does.

    Our own controller is asked and answers from sample to sample, and loses nothing by it; one that must be asked for
    each value would never be heard in its own sample.
    """

    def __init__(
        self, settings: LinkSettings, clock: Clock, log: Path | None, answer: Callable[[], None] | None
    ) -> None:
        super().__init__(settings, clock, log)
        self._answer = answer

    def receive_all(self, limit: int = 10_000) -> list[can.Message]:
        """What has arrived, answers to what was just asked among it."""
        if self._answer is not None:
            self._answer()
        return super().receive_all(limit)


@contextmanager
def virtual_bench(
    config: Config, log: Path | None = None, first: FirstTurns | None = None
) -> Iterator[tuple[CanLink, SimulatedClock, Callable[[], None]]]:
    """The configured virtual device on a bus of its own in this process, in simulated time.

    Yields the host's link, the clock, and `turn`: the device takes in what came and makes a sample.
    first : is given a link with a log of its own, clock and a turn, before the host's link opens.
    """
    clock = SimulatedClock()
    settings = replace(link_settings(config), interface="virtual", channel=f"retuner-{next(_channels)}")
    with CanLink(settings, clock) as far:
        on_bus = DeviceOnBus(make_far_side(config), far)
        if first is not None:
            with CanLink(settings, clock, _before(log)) as link:
                first(link, clock, on_bus.sample)
        answer = on_bus.answer if config.foreign_device is not None else None
        with BenchLink(settings, clock, log, answer) as near:
            yield near, clock, on_bus.sample


def _before(log: Path | None) -> Path | None:
    """The log of what happens on the bus before a session."""
    return None if log is None else log.with_name(LOG_PREFIX + log.name)


def to_the_end(session: Session, once: Callable[[], None]) -> None:
    """Turn until the session is over. Ctrl-C lets it end: an undecided change is taken back first; a second one does
    not wait for that (the controller's own trial time, or the next session, then does it). A defect of ours lets it end
    in the same way, before it is told.
    """
    try:
        while not session.finished:
            once()
    except KeyboardInterrupt:
        session.stop("stopped by the user")
        _end(session, once)
        raise
    except BaseException as defect:
        session.fail(f"{type(defect).__name__}: {defect}")
        _end(session, once)
        raise


def _end(session: Session, once: Callable[[], None]) -> None:
    """The turns that a session which was told to end still needs."""
    if session.samples:
        try:
            while not session.finished:
                once()
        finally:
            session.tell_what_is_open()


class Run:
    """One run of a configuration.

    Parameters
    ----------
    config : what to run. record : keeps rows for good. mode : overrides the configured one. log : file for bus traffic.
    on_sample : told of every sample and of the session, for progress. folder : of the session, where people put orders;
    before : that of the session which was there before and may have left some. tell : says a line to the user.
    """

    def __init__(
        self,
        config: Config,
        record: Recorder,
        *,
        mode: Mode | None = None,
        log: Path | None = None,
        on_sample: Callable[[Session, LoopSample], None] | None = None,
        folder: Path | None = None,
        before: Path | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self.config = config
        self.mode = mode
        self._record = record
        self._log = log
        self._on_sample = on_sample
        self._folder, self._before, self._tell = folder, before, tell
        self._why_no_memory = ""
        self._pretuning = Pretuning(config, record, tell) if config.adaptation.pretune else None
        self.session: Session | None = None

    def simulated(self) -> Session:
        """Run the whole scenario against the virtual device in this process, as fast as it goes.

        Raises
        ------
        DeviceError
            The bus log cannot be opened.
        """
        with self._bench() as (session, clock, turn):

            def once() -> None:
                clock.advance(self.config.loop.sample_time_s)
                turn()
                with unstoppable():
                    session.poll(clock.now_s())

            to_the_end(session, once)
            return session

    @contextmanager
    def _bench(self) -> Iterator[tuple[Session, SimulatedClock, Callable[[], None]]]:
        """The host's session on a virtual bench."""
        first = self._pretune_simulated if self._pretuning else None
        with virtual_bench(self.config, self._log, first) as (near, clock, turn):
            session = self._session(near, DecideHere(self.config.adaptation.decision_delay_samples))

            def turn_and_tell() -> None:
                turn()
                session.link_faults(near.news())

            yield session, clock, turn_and_tell

    def live(self, speed: float = 1.0) -> Session:
        """Run against whatever answers on the configured bus, until the scenario is over or the user stops it.

        speed : how much faster than real time the far side's clock runs (a simulated plant on a bench).

        Raises
        ------
        DeviceError
            The bus does not open, or nobody (or the wrong one) answers at first.
        """
        clock: Clock = MonotonicClock(speed)
        if self._pretuning is not None:
            with CanLink(link_settings(self.config, speed), clock, _before(self._log)) as link:
                pause_s = self.config.loop.sample_time_s / POLLS_PER_SAMPLE
                self._pretune(link, clock, lambda: link.wait_until(clock.now_s() + pause_s), speed)
        deadline_s = self.config.adaptation.decision_deadline_s
        with (
            DecideInWorker(deadline_s) as worker,
            CanLink(link_settings(self.config, speed), clock, self._log) as link,
        ):
            session = self._session(link, worker, speed, self._recalled())

            def once() -> None:
                with unstoppable():
                    session.poll(clock.now_s())
                    session.link_faults(link.news())
                link.wait_until(clock.now_s() + self.config.loop.sample_time_s / POLLS_PER_SAMPLE)

            try:
                to_the_end(session, once)
            finally:
                session.device.release(clock.now_s())
            return session

    def _pretune_simulated(self, link: CanLink, clock: SimulatedClock, sample: Callable[[], None]) -> None:
        """The commanded step on the virtual bench: nobody may interrupt what device and host share."""

        def turn() -> None:
            with unstoppable():
                clock.advance(self.config.loop.sample_time_s)
                sample()

        self._pretune(link, clock, turn)

    def _pretune(self, link: CanLink, clock: Clock, turn: Callable[[], None], speed: float = 1.0) -> None:
        """The commanded step before the session, on a link of its own."""
        assert self._pretuning is not None
        settings = device_settings(self.config, speed)
        owner = settings.owner % OWNERS + 1  # its lease is counted by itself
        device = make_device(self.config, link, speed, owner=owner)

        def turned() -> float:
            turn()
            return clock.now_s()

        try:
            self._pretuning.conduct(device, settings.silent_s, turned)
        finally:
            device.release(clock.now_s())

    def _recalled(self) -> Remembered | None:
        """What the session before this one has learned, if it can be trusted; why not is said in a line."""
        try:
            return recall(self._before, self.config, retuner_settings(self.config, self.mode))
        except NoMemoryError as why_not:
            self._why_no_memory = str(why_not)
            if self._tell is not None and self._why_no_memory:
                self._tell(self._why_no_memory)
            return None

    def _keep_memory(self, session: Session, remembered: Remembered | None, folder: Path) -> None:
        """From now on, write down what is learned before it is recorded as decided."""
        memory = MemoryFile(folder, self.config, self._record)
        memory.begin(remembered, self._why_no_memory)
        session.remember = lambda t_s: memory.save(session.retuner, t_s)

    def _session(
        self, link: CanLink, decider: Decider, speed: float = 1.0, remembered: Remembered | None = None
    ) -> Session:
        """The host's side on an open link."""
        after_s = remembered.last_s if remembered is not None else None
        device = make_device(self.config, link, speed, after_s=after_s)
        retuner = remembered.retuner if remembered is not None else make_retuner(self.config, self.mode)
        scenario = ScenarioPlayer(self.config.scenario)
        session = Session(device, retuner, scenario, self._record, self._sampled, decider)
        prove_order(self.config, device, session, self._record)
        if isinstance(decider, DecideInWorker) and self._folder is not None:
            self._keep_memory(session, remembered, self._folder)
        if self._folder is not None:
            session.orders = OrderDesk(
                OrderBox(self._folder),
                retuner,
                self._record,
                session.decisions,
                self.config.adaptation.approval_s,
                left_before(self._before),
            ).take
        if self._pretuning is not None:
            session.orders = self._pretuning.decisions(retuner, session.orders)
        self.session = session
        return session

    def _sampled(self, sample: LoopSample) -> None:
        """Pass a sample on to whoever shows progress."""
        if self._on_sample is not None and self.session is not None:
            self._on_sample(self.session, sample)


# --speed: simulated time, or how much faster than real time the far side of a bus runs.


def real_time_speed(text: str, *, simulated: bool) -> float:
    """--speed as a number: "max" is simulated time; a number is how much faster than real time the far side runs.

    Raises
    ------
    UserError
        Neither "max" nor a positive number, or "max" for a bus that leaves this process.
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
