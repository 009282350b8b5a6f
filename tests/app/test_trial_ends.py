"""Ends of a trial that look like the end and are not: what the controller runs a while after the host is content."""

from collections.abc import Callable

import can
import pytest
from wire import GOOD, OTHER, PROMISE, Wire, is_telemetry, wires

from retuner.adaptive.orders.operator_orders import revert
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.trial.phase import TrialPhase
from retuner.drivers.protocol.checksum import to_wire
from retuner.drivers.protocol.frames import Ack, GainBox, Kind, Reason
from retuner.schedule.gains import PidGains
from retuner.schedule.table import Lookup
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
