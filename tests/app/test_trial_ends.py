"""Ends of a trial that look like the end and are not: what the controller runs a while after the host is content."""

import json
from collections.abc import Callable, Iterator

import can
import pytest
from command_line import printed
from two_regions import two_regions
from wire import GOOD, OTHER, PROMISE, Wire, is_telemetry, wires

from retuner import Lookup, PidGains, remember, restore
from retuner.adaptive.orders.operator_orders import revert
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.trial.phase import TrialPhase
from retuner.cli import main
from retuner.drivers.controller.gain_memory import GainSet
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.protocol.checksum import to_wire
from retuner.drivers.protocol.frames import Ack, GainBox, Kind, Reason
from retuner.ledger import LedgerReader
from retuner.session.running import to_the_end

P = TrialPhase
NEW = PidGains(4 * GOOD.kp, 4 * GOOD.ki)


make_wire = pytest.fixture(wires)


def on_trial(wire: Wire, seen: int = 10) -> Wire:
    """A change is on trial, and has run for so many samples: the controller holds it for confirmed after 6."""
    wire.ask(NEW)
    wire.until(P.TRIAL)
    wire.run(seen)
    assert wire.runs == to_wire(NEW)
    return wire


def alone(wire: Wire, samples: int = 100) -> None:
    """The host is gone."""
    for _ in range(samples):
        wire.device.step()


@pytest.mark.parametrize("seen", [0, 3, 6, 10])
def test_the_controller_does_not_go_back_to_the_tried_set_when_the_session_is_over(make_wire, seen):
    wire = on_trial(make_wire(trial_samples=20), seen)
    wire.end()
    assert wire.kinds[-1] == "restored"
    alone(wire)
    assert wire.runs == to_wire(GOOD)


def test_nor_when_the_schedule_had_just_written_the_other_region(make_wire: Callable[..., Wire]) -> None:
    wire = on_trial(make_wire(trial_samples=20))
    wire.session.device.send_setpoint(70.0, wire.clock.now_s())
    wire.until(P.AWAY)
    while wire.runs != to_wire(OTHER):
        wire.run(1)
    wire.end()
    alone(wire)
    assert wire.runs == to_wire(OTHER)


def test_nor_when_no_sample_comes_that_shows_the_restored_set(make_wire: Callable[..., Wire]) -> None:
    wire = on_trial(make_wire(trial_samples=20))
    wire.heard = lambda message: not is_telemetry(message)
    wire.end()
    assert wire.kinds[-1] == "restored"
    alone(wire)
    assert wire.runs == to_wire(GOOD)


def test_a_restored_set_that_is_never_confirmed_is_told(make_wire: Callable[..., Wire]) -> None:
    wire = on_trial(make_wire(trial_samples=20))
    wire.device.pages.confirm = lambda frame: Ack(Kind.CONFIRM, frame.seq, Reason.NOT_OWNER, 0)
    wire.end()
    assert wire.kinds[-1] == "unrestored"


def test_samples_that_stay_away_end_the_trial_although_the_link_lives(make_wire: Callable[..., Wire]) -> None:
    wire = on_trial(make_wire(trial_samples=20))
    wire.heard = lambda message: not is_telemetry(message)
    wire.run(60)
    assert dict(wire.rows)["abort"]["cause"] == "lost_telemetry"
    assert wire.kinds[-1] == "restored"
    assert wire.runs == to_wire(GOOD)
    wire.run(100)
    assert wire.runs == to_wire(GOOD)


def test_a_tried_set_that_cannot_be_replaced_elsewhere_is_given_up_and_told(make_wire: Callable[..., Wire]) -> None:
    wire = on_trial(make_wire())
    box, wire.device.pages._box = wire.device.pages._box, GainBox(ratio_max=1.001)
    wire.session.device.send_setpoint(70.0, wire.clock.now_s())
    wire.until(P.RESTORING)
    assert wire.session.writer.restoring
    wire.device.pages._box = box
    wire.until(P.COOLING, most=200)
    assert wire.runs == to_wire(OTHER)
    assert wire.session.table.gains == (GOOD, OTHER)


def test_what_is_decided_when_the_end_has_begun_is_taken_back_as_well(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire()
    wire.session.freeze("the disk is full")
    wire.run(1)
    wire.ask(NEW)
    wire.run(5)
    assert wire.trials.phase(0) is P.COOLING
    assert wire.runs == to_wire(GOOD)


def test_a_change_decided_while_an_order_is_written_does_not_take_its_place(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire()
    ordered, ours = PidGains(1.5 * GOOD.kp, 1.5 * GOOD.ki), wire.session.retuner
    wire.asked.append(revert(ours, 0, ordered, wire.clock.now_s()))
    wire.run(1)
    assert wire.session.writer.open
    wire.session._decided(ours.ordered(0, Outcome("injected", "for a test"), NEW, PROMISE))
    wire.run(20)
    assert wire.trials.phase(0) is P.IDLE
    assert dict(wire.rows)["dropped"]["reason"] == "another change is in progress"
    wire.end()
    assert wire.runs == to_wire(ordered)


@pytest.mark.parametrize("share", [1.015, 1.05])
def test_in_an_interpolated_table_a_small_change_is_taken_back_as_well(make_wire, share):
    wire = make_wire(lookup=Lookup.INTERPOLATED)
    before = wire.runs
    wire.ask(PidGains(share * GOOD.kp, share * GOOD.ki))
    wire.until(P.TRIAL)
    assert wire.runs != before
    wire.end()
    assert wire.runs == before


def test_the_rollback_is_open_while_the_telemetry_is_garbage(make_wire: Callable[..., Wire]) -> None:
    wire = on_trial(make_wire())
    step = wire.device.step

    def garbled() -> list[can.Message]:
        return [
            can.Message(arbitration_id=m.arbitration_id, data=b"\x55" + m.data[1:], is_extended_id=False)
            if is_telemetry(m)
            else m
            for m in step()
        ]

    wire.device.step = garbled
    wire.run(60)
    assert dict(wire.rows)["restore"]["cause"] == "gap"
    assert wire.kinds[-1] == "restored"
    assert wire.runs == to_wire(GOOD)


@pytest.mark.parametrize("where", ["_seen", "_observe", "progress", "judge"])
def test_a_defect_of_ours_takes_the_change_back_before_it_is_told(make_wire: Callable[..., Wire], where: str) -> None:
    wire = on_trial(make_wire())
    session = wire.session

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError(where)

    owners = {"progress": (session, "_on_sample"), "judge": (session.retuner.trials, "watch")}
    owner, name = owners.get(where, (session.retuner, where))
    assert hasattr(owner, name)  # else nothing breaks, and the session has no end
    setattr(owner, name, broken)
    if where == "_seen":
        session.device.send_setpoint(55.0, wire.clock.now_s())
    with pytest.raises(ZeroDivisionError, match=where):
        to_the_end(session, lambda: wire.run(1))
    assert wire.runs == to_wire(GOOD)
    assert wire.kinds[-1] == "restored"


def test_a_defect_that_stays_is_told_as_what_is_open(make_wire: Callable[..., Wire]) -> None:
    wire = on_trial(make_wire())

    def once() -> None:
        raise OSError("the bus is on fire")

    with pytest.raises(OSError, match="on fire"):
        to_the_end(wire.session, once)
    assert wire.kinds[-1] == "unrestored"


# A run that ends in mid-trial: the change is taken back, told everywhere, and a replay decides it again.


SHORT = two_regions("auto", 50.0, "at_s = 0.0, sp = 2.0", "at_s = 20.0, sp = 3.0")
"""A sluggish loop: its first response ends three seconds before the run does."""


@pytest.mark.slow
@pytest.mark.uncounted
def test_an_undecided_change_that_is_robust_stays_at_the_end_and_is_decided_again_by_a_replay(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    assert "Session ended during the trial; trial gains kept" in printed("run", "short.toml", "--no-compare")
    with LedgerReader(tmp_path / "out" / "ledger.sqlite") as reader:
        rows = [(row.kind, json.loads(row.text)) for row in reader.rows()]
        assert reader.verify().ok
    bodies = dict(rows)
    told = [kind for kind, _ in rows if kind in {"trial", "abort", "restore", "restored"}]
    assert told == ["trial", "abort", "restored"]
    assert bodies["restored"]["gains"] == bodies["trial"]["gains"]
    assert bodies["decision"]["code"] == "kept_stopped"
    assert bodies["decision"]["gains_after"] == bodies["trial"]["gains"]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["scores"][0]["after"] != summary["scores"][0]["before"]
    assert "identical" in printed("replay", "out")


@pytest.mark.parametrize("back", [pytest.param(False, marks=[pytest.mark.slow, pytest.mark.uncounted]), True])
def test_a_turned_action_is_an_alarm_in_the_run_and_is_decided_again_by_a_replay(tmp_path, monkeypatch, capsys, back):
    """Someone turns the action at the controller in the middle of a trial; and back again, or not."""
    step = VirtualDevice.step

    def turns(device: VirtualDevice, dt_s: float | None = None) -> list[can.Message]:
        if device.sample == 480 or (back and device.sample == 490):
            pages, gains = device.pages, device.pages.running.gains
            pages.latest += 1
            pages.running = pages.confirmed = GainSet(pages.latest, PidGains(-gains.kp, -gains.ki, -gains.kd))
        return step(device, dt_s)

    monkeypatch.setattr(VirtualDevice, "step", turns)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    assert main(["run", "short.toml", "--no-compare"]) == (0 if back else 2)
    told = capsys.readouterr()
    assert "other sign" in told.out
    assert back or "other sign" in told.err
    with LedgerReader(tmp_path / "out" / "ledger.sqlite") as reader:
        rows = [(row.kind, row.body) for row in reader.rows()]
    turned = [body["turned"] for kind, body in rows if kind == "action"]
    assert turned == ([True, False] if back else [True])
    after = [kind for kind, _ in rows[[kind for kind, _ in rows].index("action") :]]
    assert back or "intent" not in after
    assert "identical" in printed("replay", "out")


# A session that dies in the middle of a write: the next one looks what runs before it writes anything.


UNSTABLE = PidGains(6 * GOOD.kp, 6 * GOOD.ki)


@pytest.fixture
def died() -> Iterator[Wire]:
    """Its memory was written when the cure had been decided; what came after it is lost."""
    wire = Wire(low=UNSTABLE)
    wire.know()
    wire.ask(GOOD)
    yield wire
    wire.close()


def begin_again(wire: Wire, memory: dict[str, object]) -> None:
    """The next session, by its retuner: nothing else of the one before is known."""
    retuner = restore(json.loads(json.dumps(memory)), wire.session.retuner.settings)
    wire.session.retuner = wire.session.writer.retuner = retuner
    wire.session.writer._pending = None
    assert retuner.trials.phase(0) is P.WRITING


def test_a_cure_that_came_through_is_on_trial_again(died: Wire) -> None:
    memory = remember(died.session.retuner)
    died.until(P.TRIAL)
    assert died.runs == to_wire(GOOD)
    begin_again(died, memory)
    for _ in range(20):
        died.run(1)
        assert died.runs == to_wire(GOOD)
    assert died.trials.phase(0) is P.TRIAL
    assert to_wire(died.session.table.gains_of(0)) == to_wire(GOOD)


def test_one_that_came_through_after_it_was_given_up_stays(died: Wire) -> None:
    memory = remember(died.session.retuner)
    died.until(P.TRIAL)
    begin_again(died, memory)
    died.heard = lambda _: False
    died.run(8)
    died.heard = lambda _: True
    died.run(60)
    assert died.runs == to_wire(GOOD)
    assert died.trials.phase(0) is P.TRIAL


def test_what_did_not_come_through_is_told_and_nothing_is_written(died: Wire) -> None:
    memory = remember(died.session.retuner)
    died.asked.clear()
    begin_again(died, memory)
    died.run(20)
    assert died.runs == to_wire(UNSTABLE)
    assert died.trials.phase(0) is P.IDLE
    assert "in the middle of it" in str(dict(died.rows)["dropped"]["reason"])
