"""A cure on trial stays on the controller, whatever ends the trial: the set before would make the loop unstable."""

from collections.abc import Callable, Iterator

import pytest
from test_trial_wire import CAUSES, EDITED
from wire import FOREIGN, GOOD, OTHER, PLANT, Wire, is_telemetry

from retuner import Action, Mode, PidGains
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.orders.operator_orders import revert
from retuner.adaptive.trial.phase import TrialPhase
from retuner.drivers.protocol.checksum import to_wire
from retuner.session.running import to_the_end

P = TrialPhase
UNSTABLE = PidGains(6 * GOOD.kp, 6 * GOOD.ki)


@pytest.fixture
def make_wire() -> Iterator[Callable[..., Wire]]:
    made: list[Wire] = []

    def make(**arguments: object) -> Wire:
        made.append(Wire(low=UNSTABLE, **arguments))
        made[-1].know()
        return made[-1]

    yield make
    for wire in made:
        wire.close()


def cured(wire: Wire) -> Wire:
    wire.ask(GOOD)
    wire.until(P.TRIAL)
    wire.run(10)
    return wire


def test_the_set_before_is_unstable_indeed() -> None:
    assert sensitivity_peak(PLANT, UNSTABLE) == float("inf")


@pytest.mark.parametrize("cause", [c for c in CAUSES if c not in EDITED | {"ordered back"}])
def test_it_runs_after_every_cause_and_after_the_end(make_wire: Callable[..., Wire], cause: str) -> None:
    wire = cured(make_wire(trial_samples=20))
    CAUSES[cause](wire)
    wire.run(20)
    if not wire.session.finished:
        wire.end()
    assert wire.runs == to_wire(GOOD)
    assert to_wire(wire.session.table.gains_of(0)) == to_wire(GOOD)
    assert "unrestored" not in wire.kinds
    for _ in range(100):  # the host is gone
        wire.device.step()
    assert wire.runs == to_wire(GOOD)


@pytest.mark.parametrize("cause", ["link lost", "telemetry lost", "restart", "manual"])
def test_its_trial_goes_on_when_it_can_be_watched_again(make_wire: Callable[..., Wire], cause: str) -> None:
    wire = cured(make_wire())
    CAUSES[cause](wire)
    wire.run(10)
    wire.until(P.TRIAL, most=80)
    assert wire.runs == to_wire(GOOD)
    kept = [d for d in wire.session.decisions if d.code.startswith("kept_")]
    assert kept
    assert "previous gains unstable" in kept[-1].reason
    assert all(d.gains_after in {None, wire.session.table.gains_of(0)} for d in kept)
    assert not any(d.code.startswith("undo_") for d in wire.session.decisions)


def test_the_end_of_the_session_tells_it_once_and_leaves_nothing_open(make_wire: Callable[..., Wire]) -> None:
    wire = cured(make_wire())
    wire.end()
    kinds = [kind for kind in wire.kinds if kind not in {"link", "lease"}]
    assert kinds[-3:] == ["abort", "decision", "restored"]
    assert wire.session.decisions[-1].code == "kept_stopped"
    assert wire.session.decisions[-1].action is Action.RESTORE
    assert wire.trials.phase(0) is P.PAUSED


def test_ctrl_c_in_the_middle_of_its_write_lets_it_come_through(make_wire: Callable[..., Wire]) -> None:
    wire = make_wire()
    wire.ask(GOOD)
    for _ in range(20):
        if wire.session.writer.open:
            break
        wire.run(1)
    left = [1]

    def once() -> None:
        if left[0]:
            left[0] -= 1
            raise KeyboardInterrupt
        wire.run(1)

    with pytest.raises(KeyboardInterrupt):
        to_the_end(wire.session, once)
    assert wire.runs == to_wire(GOOD)
    assert to_wire(wire.session.table.gains_of(0)) == to_wire(GOOD)
    (told,) = (body["reason"] for kind, body in wire.rows if kind == "trial")  # after a decision that gave it up
    assert str(told).startswith("it was written after all, and stays: over the")


def test_it_stays_while_another_region_is_in_force(make_wire: Callable[..., Wire]) -> None:
    wire = cured(make_wire())
    wire.session.device.send_setpoint(70.0, wire.clock.now_s())
    wire.until(P.AWAY)
    while wire.runs != to_wire(OTHER):
        wire.run(1)
    wire.end()
    assert wire.runs == to_wire(OTHER)
    assert to_wire(wire.session.table.gains_of(0)) == to_wire(GOOD)


def test_samples_that_stay_away_are_told_once_and_do_not_bring_the_unstable_set_back(make_wire):
    wire = cured(make_wire())
    wire.heard = lambda message: not is_telemetry(message)
    wire.run(60)
    assert wire.runs == to_wire(GOOD)
    assert wire.kinds.count("abort") == 1


def test_a_person_who_orders_it_back_is_told_why_not(make_wire: Callable[..., Wire]) -> None:
    wire = cured(make_wire())
    decision = revert(wire.session.retuner, 0, UNSTABLE, wire.clock.now_s())
    assert decision.code == "revert_refused"
    assert "unstable" in decision.reason
    assert wire.trials.phase(0) is P.TRIAL


@pytest.mark.uncounted
def test_in_mode_trial_what_no_response_decides_waits_for_a_person(make_wire: Callable[..., Wire]) -> None:
    wire = cured(make_wire(mode=Mode.TRIAL, settles=1.0))
    wire.until(P.WAITING, most=2000)
    assert wire.runs == to_wire(GOOD)
    auto = cured(make_wire(settles=1.0))
    auto.run(2000)
    assert auto.trials.phase(0) is P.TRIAL


def test_an_edit_is_taken_over_held_and_told(make_wire: Callable[..., Wire]) -> None:
    wire = cured(make_wire(edit_hold_s=50.0))
    wire.edit(FOREIGN)
    wire.until(P.HELD)
    decision = wire.session.decisions[-1]
    assert decision.code == "edited"
    assert "held for 50 s" in decision.reason
    assert "the trial of these gains ended without a verdict" in decision.reason
    assert "Ms at most" in decision.reason
    wire.run(60)
    assert wire.runs == to_wire(FOREIGN)
    assert to_wire(wire.session.table.gains_of(0)) == to_wire(FOREIGN)
    assert wire.trials.may_change(0, wire.clock.now_s())
    wire.end()
    assert wire.runs == to_wire(FOREIGN)


def test_an_end_that_waits_tells_each_cause_once(make_wire: Callable[..., Wire]) -> None:
    """With the device off, both the lost telemetry and the end of the session concern the trial at every poll."""
    wire = cured(make_wire())
    wire.far.send = lambda message: None  # noqa: ARG005  nothing arrives
    wire.run(20)
    told = len(wire.rows)
    wire.end()
    causes = [str(body["cause"]) for kind, body in wire.rows[told:] if kind == "abort"]
    assert causes.count("stopped") == 1
    assert len(causes) == len(set(causes))
    assert wire.kinds[-1] == "unrestored"
