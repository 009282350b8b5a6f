"""The session against a scripted controller: order of record and effect, and writes that do not come off."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import pytest

from retuner import Action, Decision, GainTable, LoopSample, Mode, PidGains, Regions, Retuner, RetunerSettings
from retuner.adaptive.supervision.question import Step
from retuner.config.bench_config import ScenarioConfig
from retuner.drivers.bus.bus import HOLDING, FaultNews, LinkFault
from retuner.drivers.device import (
    CommandFailed,
    DeviceConflict,
    Event,
    ForeignHost,
    LeaseChanged,
    LinkChanged,
    LinkState,
    Reverted,
    RunningChanged,
    RunningSet,
    SamplesLost,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
    WriteUnknown,
)
from retuner.session.gain_writer import HOLD_SAMPLES, RETRY_SAMPLES
from retuner.session.loop_session import LoopSession
from retuner.session.scenario import ScenarioPlayer
from retuner.session.session import Session

LOW, HIGH, BETTER = PidGains(1.0, 0.1), PidGains(2.0, 0.2), PidGains(1.5, 0.15)
TABLE = GainTable("loop", Regions("sp", "-", ("low", "high"), 0.0, (50.0,), 100.0, 1.0, 0.0), (LOW, HIGH))


class Log:
    """Rows and device calls in the order in which they happened."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, object]] = []

    def record(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        del t_s
        self.lines.append((kind, dict(body)))

    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.lines]


@dataclass
class ScriptedDevice:
    """Reports what the test puts into `events`."""

    log: Log
    events: list[Event] = field(default_factory=list)
    running: RunningSet | None = field(default_factory=lambda: RunningSet(1, LOW, 0))
    connected: bool = True
    writing: bool = False
    refuse: bool = False

    def poll(self, now_s: float) -> list[Event]:
        del now_s
        events, self.events = self.events, []
        return events

    def begin_write(self, gains: PidGains, now_s: float, *, back: bool = False) -> int:
        del now_s, back
        if self.refuse:
            raise WriteRefusedError("no")
        self.log.lines.append(("begin_write", gains))
        self.writing = True
        return 2

    def send_setpoint(self, sp: float, now_s: float) -> None:
        del now_s
        self.log.lines.append(("setpoint", sp))

    def send_mode(self, *, auto: bool, co: float, now_s: float) -> None:
        del now_s
        self.log.lines.append(("mode", (auto, co)))

    def send_load(self, load: float, now_s: float) -> None:
        del now_s
        self.log.lines.append(("load", load))

    def store(self, now_s: float) -> None:
        del now_s

    def confirm(self, now_s: float) -> bool:
        del now_s
        return True

    def finish(self, gains: PidGains) -> None:
        self.writing = False
        self.running = RunningSet(2, gains, 7)
        self.events.append(WriteDone(2, gains, self.running))

    def fail(self) -> None:
        self.writing = False
        assert self.running is not None
        self.events.append(WriteFailed(2, "refused: ratio", self.running))


class DecidingRetuner(Retuner):
    """Decides when the test says so; everything else is the real one."""

    wish: PidGains | None = None
    wished_in: int | None = None
    """Region of the wish; where the loop is, if nothing is said."""

    def step(self, sample: LoopSample) -> Step:
        found = super().step(sample)
        if self.wish is None or self.region is None:
            return found
        wish, self.wish = self.wish, None
        at = self.region if self.wished_in is None else self.wished_in
        name = self.table.regions.names[at]
        wished = Decision(
            1, sample.t_s, "loop", name, Mode.AUTO, Action.WRITE, "accepted", "because", self.table.gains_of(at), wish
        )
        return Step(wished)


class Stage:
    """A session with its scripted device."""

    def __init__(self, scenario: ScenarioConfig | None = None) -> None:
        self.log = Log()
        self.device = ScriptedDevice(self.log)
        self.retuner = DecidingRetuner(TABLE, RetunerSettings(1.0, 100.0))
        self.session = LoopSession(self.device, self.retuner, ScenarioPlayer(scenario), self.log.record)
        self.t = 0.0

    def tick(self, sp: float = 20.0, n: int = 1) -> None:
        for _ in range(n):
            self.t += 1.0
            self.device.events.append(LoopSample(self.t, sp, sp, 30.0, 1, 0, sp, 1))
            self.session.poll(self.t)


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_nothing_is_written_while_the_controller_runs_what_the_table_says(stage: Stage) -> None:
    stage.tick(n=50)
    assert stage.log.lines == []


def test_the_intent_is_recorded_before_the_write_begins_and_the_table_changes_after_it_is_done(stage: Stage) -> None:
    stage.tick(n=3)
    stage.retuner.wish = BETTER
    stage.tick()
    assert stage.log.kinds() == ["decision", "intent", "begin_write"]
    assert stage.session.table.gains_of(0) == LOW
    stage.tick(n=3)
    assert stage.session.table.gains_of(0) == LOW
    stage.device.finish(BETTER)
    stage.tick()
    assert stage.log.kinds() == ["decision", "intent", "begin_write", "committed"]
    assert stage.session.table.gains_of(0) == BETTER
    assert stage.session.table.revision == 1
    stage.tick(n=5)
    assert stage.log.kinds()[-1] == "committed"


def test_the_gains_that_were_read_back_are_the_ones_in_the_table(stage: Stage) -> None:
    stage.tick()
    stage.retuner.wish = BETTER
    stage.tick()
    rounded = PidGains(1.5000001, 0.15000001)
    stage.device.finish(rounded)
    stage.tick()
    assert stage.session.table.gains_of(0) == rounded


@pytest.mark.parametrize("fault", LinkFault)
def test_trouble_on_the_link_is_recorded_and_holds_the_adaptation_for_a_while(stage: Stage, fault: LinkFault) -> None:
    stage.tick(n=3)
    stage.session.link_faults([FaultNews(fault, 7)])
    assert stage.log.lines == [("bus", {"fault": fault, "times": 7})]
    stage.retuner.wish = BETTER
    stage.tick(n=HOLD_SAMPLES)
    if fault not in HOLDING:
        assert stage.log.kinds() == ["bus", "decision", "intent", "begin_write"]
        return
    assert stage.log.kinds() == ["bus", "decision", "dropped"]
    assert stage.log.lines[-1][1]["reason"] == f"too soon after: {fault}"
    stage.retuner.wish = BETTER
    stage.tick()
    assert stage.log.kinds()[3:] == ["decision", "intent", "begin_write"]


def test_a_lost_link_holds_the_adaptation_and_the_schedule_goes_on(stage: Stage) -> None:
    stage.tick(n=3)
    stage.device.events.append(LinkChanged(LinkState.SILENT, "no frame for 20 s"))
    stage.device.events.append(LinkChanged(LinkState.UP, "heard"))
    stage.retuner.wish = BETTER
    stage.tick()
    assert stage.log.kinds() == ["link", "link", "decision", "dropped"]
    stage.tick(sp=80.0)
    assert stage.log.kinds()[4:] == ["intent", "begin_write"]
    assert stage.log.lines[-1][1] == HIGH


def test_a_frozen_session_begins_nothing_and_ends_when_its_write_has_ended(stage: Stage) -> None:
    stage.tick(n=3)
    stage.retuner.wish = BETTER
    stage.tick()
    stage.session.freeze("the disk is full")
    stage.session.freeze("and fuller")
    assert not stage.session.finished
    stage.device.finish(BETTER)
    stage.tick(sp=80.0, n=5)
    assert stage.log.kinds() == ["decision", "intent", "begin_write", "committed"]
    assert stage.session.finished
    assert stage.session.frozen == "the disk is full"


def test_a_failed_write_leaves_the_table_and_is_recorded(stage: Stage) -> None:
    stage.tick()
    stage.retuner.wish = BETTER
    stage.tick()
    stage.device.fail()
    stage.tick(n=3)
    assert stage.log.kinds() == ["decision", "intent", "begin_write", "refused"]
    assert stage.session.table == TABLE


def test_a_write_that_is_not_even_started_is_recorded_as_refused(stage: Stage) -> None:
    stage.tick()
    stage.device.refuse = True
    stage.retuner.wish = BETTER
    stage.tick()
    assert stage.log.kinds() == ["decision", "intent", "refused"]
    assert stage.session.table == TABLE


def test_another_region_has_its_gains_written_and_the_table_stays(stage: Stage) -> None:
    stage.tick(n=2)
    stage.tick(sp=80.0)
    assert stage.log.kinds() == ["intent", "begin_write"]
    assert stage.log.lines[1] == ("begin_write", HIGH)
    stage.device.finish(HIGH)
    stage.tick(sp=80.0, n=5)
    assert stage.log.kinds() == ["intent", "begin_write", "committed"]
    assert stage.session.table == TABLE


def test_a_schedule_write_that_failed_is_tried_again_after_a_while(stage: Stage) -> None:
    stage.tick()
    stage.tick(sp=80.0)
    stage.device.fail()
    stage.tick(sp=80.0, n=RETRY_SAMPLES - 2)
    assert stage.log.kinds().count("begin_write") == 1
    stage.tick(sp=80.0, n=4)
    assert stage.log.kinds().count("begin_write") == 2


def test_a_decision_for_a_region_where_the_loop_is_not_changes_the_table_and_is_written_when_it_comes(stage):
    stage.tick()
    stage.retuner.wish, stage.retuner.wished_in = BETTER, 1
    stage.tick(n=2)
    assert stage.log.kinds() == ["decision", "committed"]
    assert "when it comes" in str(stage.log.lines[-1][1]["reason"])
    assert (stage.session.table.gains_of(0), stage.session.table.gains_of(1)) == (LOW, BETTER)
    stage.tick(sp=80.0)
    assert stage.log.lines[-1] == ("begin_write", BETTER)


def test_a_decision_for_a_region_that_was_left_meanwhile_is_dropped(stage: Stage) -> None:
    stage.tick()
    stage.device.writing = True  # the wire is busy
    stage.retuner.wish = BETTER
    stage.tick()
    stage.tick(sp=80.0)
    stage.device.writing = False
    stage.tick(sp=80.0)
    assert "dropped" in stage.log.kinds()
    assert ("begin_write", HIGH) in stage.log.lines
    assert ("begin_write", BETTER) not in stage.log.lines


def test_nothing_is_written_without_a_connection_or_a_known_running_set(stage: Stage) -> None:
    stage.tick()
    stage.device.connected = False
    stage.tick(sp=80.0, n=5)
    stage.device.connected, stage.device.running = True, None
    stage.tick(sp=80.0, n=5)
    assert stage.log.lines == []


@pytest.mark.parametrize(
    ("event", "kind"),
    [
        (WriteUnknown(2, "no answer"), "unknown"),
        (LinkChanged(LinkState.SILENT, "age 5 s"), "link"),
        (SamplesLost(3, 7.0), "lost"),
        (CommandFailed("setpoint", "out of range"), "command"),
        (RunningChanged(RunningSet(3, PidGains(1.0, 0.1), 7)), "foreign"),
        (Reverted(RunningSet(1, PidGains(1.0, 0.1), 7)), "reverted"),
        (LeaseChanged(ours=False, owner=77), "lease"),
        (ForeignHost(4), "foreign_host"),
        (DeviceConflict(1), "conflict"),
    ],
)
def test_trouble_is_recorded(stage: Stage, event: Event, kind: str) -> None:
    stage.device.events.append(event)
    stage.session.poll(0.0)
    assert stage.log.kinds() == [kind]


def test_a_loop_in_the_middle_of_a_write_is_looked_after_between_slow_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """A look at one of four loops takes three sample times: after all four a controller's trial may be over."""
    stages, looks, now = [Stage() for _ in range(4)], list[tuple[int, float]](), [0.0]

    def slow(i: int, now_s: float) -> list[Event]:
        looks.append((i, now_s))
        now[0] += 3.0
        return []

    for i, stage in enumerate(stages):
        monkeypatch.setattr(stage.device, "poll", partial(slow, i))
    session = Session([stage.session for stage in stages], print)
    for writing, seen in ((False, [0, 1, 2, 3]), (True, [0, 1, 2, 2, 3, 2]), (True, [0, 2, 1, 2, 2, 2, 3, 2])):
        stages[2].device.writing = writing
        session.poll(now[0], range(4), lambda: now[0])
        assert [i for i, _ in looks] == seen
        assert [at for i, at in looks if i == 2] == sorted(at for i, at in looks if i == 2)
        looks.clear()


@pytest.mark.parametrize(("look_s", "most"), [(0.02, 12), (3.0, 3)])
def test_loops_in_the_middle_of_a_write_take_half_of_the_time_at_the_most(monkeypatch, look_s, most):
    """Of twelve loops eleven are being written. Those whose look is short are all looked at between any two others."""
    stages, looks, now = [Stage() for _ in range(12)], [0] * 12, [0.0]

    def slow(i: int, _: float) -> list[Event]:
        looks[i] += 1
        now[0] += look_s if looks[i] > 1 else 3.0
        return []

    for i, stage in enumerate(stages):
        monkeypatch.setattr(stage.device, "poll", partial(slow, i))
        stage.device.writing = i > 0
    session = Session([stage.session for stage in stages], print)
    session.poll(0.0, range(12), lambda: now[0])
    assert now[0] <= 2 * 36.0 + look_s
    assert max(looks) == most


def test_the_scenario_is_played_once_at_its_times() -> None:
    steps = [{"at_s": 0.0, "sp": 20.0}, {"at_s": 3.0, "sp": 25.0, "load": -5.0}, {"at_s": 5.0, "load": 0.0}]
    stage = Stage(ScenarioConfig.model_validate({"duration_s": 8.0, "steps": steps}))
    stage.tick(n=8)
    assert stage.log.lines == [("setpoint", 20.0), ("setpoint", 25.0), ("load", -5.0), ("load", 0.0)]
    assert not stage.session.finished
    stage.tick()
    assert stage.session.finished


def test_a_run_is_not_over_while_a_write_is_open() -> None:
    stage = Stage(ScenarioConfig.model_validate({"duration_s": 3.0, "steps": [{"at_s": 0.0, "sp": 20.0}]}))
    stage.tick(n=2)
    stage.retuner.wish = BETTER
    stage.tick(n=5)
    assert not stage.session.finished
    stage.device.finish(BETTER)
    stage.tick()
    assert stage.session.finished
