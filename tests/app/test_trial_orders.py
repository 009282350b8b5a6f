"""Orders that meet a trial: each ends it, lets it be, or is told why not; none is for another set than it names."""

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest
from wire import GOOD, PROMISE, Wire

from retuner.adaptive.orders.pending_proposal import Proposal
from retuner.adaptive.supervision.decision import Action, Decision, Mode, Outcome
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.drivers.protocol.checksum import to_wire
from retuner.schedule.gains import PidGains
from retuner.session.ledger_rows import feed
from retuner.session.order_queue import Before, OrderDesk, OrderState
from retuner.session.orders import REGIONAL, Order, OrderBox, OrderKind, put_order

P = TrialPhase


class Desk(NamedTuple):
    """A session that takes orders from a folder."""

    wire: Wire
    folder: Path

    def tried(self, factor: float) -> Decision:
        """A change is written and on trial; its decision."""
        session = self.wire.session
        gains = PidGains(factor * GOOD.kp, factor * GOOD.ki)
        session._decided(session.retuner.ordered(0, Outcome("injected", "for a test"), gains, PROMISE))
        self.wire.until(P.TRIAL)
        return next(d for d in reversed(session.decisions) if d.action is Action.WRITE)

    def happens(self, event: TrialEvent) -> None:
        self.wire.trials.event(0, event, self.wire.clock.now_s())

    def order(
        self, kind: OrderKind, digest: str = "", decision: int = 0, mode: str = "", gains: PidGains | None = None
    ) -> dict[str, object]:
        """Give an order, and let it be taken; its last row."""
        region = "low" if kind in REGIONAL else ""
        put_order(self.folder, Order(kind, "Ada", "2030-01-31T12:00:00Z", "", digest, decision, region, mode, gains))
        self.wire.run(60)
        return dict([body for row, body in self.wire.rows if row == "order"][-1])


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    wire = Wire(mode=Mode.TRIAL, cool_down_s=0.0)
    session = wire.session
    session.orders = OrderDesk(OrderBox(tmp_path), session.retuner, wire._record, session.decisions, 1e6).take
    yield Desk(wire, tmp_path)
    wire.close()


def test_a_persons_own_proposal_is_an_order_and_its_refusal_a_decision(desk: Desk) -> None:
    told = desk.order(OrderKind.PROPOSE, gains=PidGains(2 * GOOD.kp, GOOD.ki))
    assert (told["accepted"], told["gains"]) == (True, {"kp": 2 * GOOD.kp, "ki": GOOD.ki, "kd": 0.0})
    decision = desk.wire.session.decisions[-1]
    assert (decision.code, decision.action) == ("order_refused", Action.NONE)
    assert "the process of this region is not known yet" in decision.reason


def test_an_approval_of_another_change_does_not_release_the_one_that_waits(desk: Desk) -> None:
    undone = desk.tried(4.0)
    desk.happens(TrialEvent.WORSE)
    desk.wire.until(P.COOLING)
    desk.wire.run(10)
    waits = desk.tried(1.5)
    desk.happens(TrialEvent.PASSED_FOR_APPROVAL)
    told = desk.order(OrderKind.APPROVE, undone.digest())
    assert not told["accepted"]
    assert told["reason"] == "low awaits approval of another change than this one"
    assert desk.wire.trials.phase(0) is P.WAITING
    assert desk.order(OrderKind.APPROVE, waits.digest())["accepted"]
    assert desk.wire.trials.phase(0) is P.IDLE


@pytest.mark.parametrize("phase", [P.TRIAL, P.AWAY, P.WAITING])
def test_the_rollback_during_a_trial_undoes_it(desk: Desk, phase: TrialPhase) -> None:
    tried = desk.tried(4.0)
    if phase is P.WAITING:
        desk.happens(TrialEvent.PASSED_FOR_APPROVAL)
    elif phase is P.AWAY:
        desk.wire.session.device.send_setpoint(70.0, desk.wire.clock.now_s())
        desk.wire.until(P.AWAY)
    told = desk.order(OrderKind.REVERT, decision=tried.number)
    if phase is P.AWAY:
        assert "waits until" in str(told["reason"])
        desk.wire.session.device.send_setpoint(50.0, desk.wire.clock.now_s())
    desk.wire.until(P.COOLING, most=200)
    desk.wire.run(40)
    assert desk.wire.runs == to_wire(GOOD)


def test_an_approval_in_a_locked_region_changes_nothing(desk: Desk) -> None:
    tried = desk.tried(4.0)
    for _ in range(3):
        desk.happens(TrialEvent.WORSE)
        desk.wire.until(P.COOLING if desk.wire.trials.of(0).rollbacks < 3 else P.LOCKED)
        if desk.wire.trials.phase(0) is P.LOCKED:
            break
        desk.wire.run(10)
        tried = desk.tried(4.0)
    assert not desk.order(OrderKind.APPROVE, tried.digest())["accepted"]
    assert desk.wire.trials.phase(0) is P.LOCKED
    assert not desk.wire.trials.may_change(0, 1e9, urgent=True)
    assert desk.order(OrderKind.UNLOCK)["accepted"]
    assert desk.wire.trials.phase(0) is P.IDLE
    assert desk.wire.runs == to_wire(GOOD)


def test_a_change_that_waits_and_is_rejected_is_taken_back(desk: Desk) -> None:
    waits = desk.tried(1.5)
    desk.happens(TrialEvent.PASSED_FOR_APPROVAL)
    assert desk.order(OrderKind.REJECT, waits.digest())["accepted"]
    desk.wire.until(P.COOLING, most=200)
    desk.wire.run(40)
    assert desk.wire.runs == to_wire(GOOD)
    told = desk.order(OrderKind.APPROVE, waits.digest())
    assert (told["accepted"], told["reason"]) == (False, "it was rejected")
    assert not desk.order(OrderKind.REJECT, "0" * 64)["accepted"]


def test_off_takes_back_what_is_on_trial_and_nothing_is_written_until_the_mode_is_another(desk: Desk) -> None:
    desk.tried(4.0)
    assert desk.order(OrderKind.MODE, mode="off")["accepted"]
    desk.wire.until(P.COOLING, most=200)
    desk.wire.run(40)
    assert desk.wire.runs == to_wire(GOOD)
    retuner = desk.wire.session.retuner
    assert [retuner.settings.mode_of(i) for i in range(2)] == [Mode.OFF, Mode.OFF]
    assert desk.order(OrderKind.MODE, mode="trial")["accepted"]
    assert retuner.settings.mode_of(0) is Mode.TRIAL
    assert [row["by"] for kind, row in desk.wire.rows if kind == "order"] == ["Ada", "Ada"]


def test_a_replay_takes_the_mode_from_the_row(desk: Desk) -> None:
    desk.order(OrderKind.MODE, mode="off")
    (row,) = (body for kind, body in desk.wire.rows if kind == "order")
    again = Wire(mode=Mode.TRIAL)
    assert feed(again.session.retuner, "order", row, 50.0) is None
    assert again.session.retuner.settings.region_modes == desk.wire.session.retuner.settings.region_modes
    again.close()


def test_a_mode_of_no_region_is_refused_and_one_region_leaves_the_other(desk: Desk) -> None:
    put_order(desk.folder, Order(OrderKind.MODE, "Ada", "2030-01-31T12:00:00Z", region="low", mode="advise"))
    put_order(desk.folder, Order(OrderKind.MODE, "Ada", "2030-01-31T12:00:01Z", region="nowhere", mode="off"))
    desk.wire.run(60)
    told = [(body["accepted"], body["reason"]) for kind, body in desk.wire.rows if kind == "order"]
    assert told == [(True, ""), (False, "there is no region nowhere; there are low, high")]
    settings = desk.wire.session.retuner.settings
    assert [settings.mode_of(i) for i in range(2)] == [Mode.ADVISE, Mode.TRIAL]


def proposed(desk: Desk) -> Decision:
    """The session proposes a change; its decision."""
    session = desk.wire.session
    gains = PidGains(1.2 * GOOD.kp, 1.2 * GOOD.ki)
    made = session.retuner.ordered(0, Outcome("injected", "for a test"), gains, PROMISE)
    desk.happens(TrialEvent.NOT_WRITTEN)
    proposal = replace(made, action=Action.ADVISE)
    session.decisions.append(proposal)
    return proposal


def test_a_rejection_that_comes_after_the_write_is_told_so(desk: Desk) -> None:
    proposal = proposed(desk)
    assert desk.order(OrderKind.APPROVE, proposal.digest())["accepted"]
    assert desk.wire.runs == to_wire(proposal.gains_after)
    told = desk.order(OrderKind.REJECT, proposal.digest())
    assert not told["accepted"]
    assert "it was approved before, and written" in str(told["reason"])
    written = next(d for d in desk.wire.session.decisions if d.code == "approved")
    assert f"order a revert of decision {written.number}" in str(told["reason"])
    assert desk.wire.runs == to_wire(proposal.gains_after)


@pytest.mark.parametrize("approved", [False, True])
def test_a_rejection_of_a_proposal_of_the_session_before(desk: Desk, tmp_path: Path, approved: bool) -> None:
    proposal, session = proposed(desk), desk.wire.session
    digest = proposal.digest()
    shown = OrderState({digest: Proposal.of(proposal)}, approved={digest} if approved else set())
    folder = tmp_path / "before"
    folder.mkdir()
    put_order(folder, Order(OrderKind.REJECT, "Ada", "2030-01-31T12:00:00Z", digest=digest))
    before = Before(OrderBox(folder), shown)
    session.orders = OrderDesk(OrderBox(tmp_path), session.retuner, desk.wire._record, deque(), 1e6, before).take
    desk.wire.run(3)
    (told,) = (body for row, body in desk.wire.rows if row == "order")
    assert (told["accepted"], told["region"]) == (not approved, "low")
    assert ("it was approved in that session" in str(told["reason"])) is approved


def test_a_rejection_before_the_approval_keeps_it_from_being_written(desk: Desk) -> None:
    proposal = proposed(desk)
    assert desk.order(OrderKind.REJECT, proposal.digest())["accepted"]
    assert desk.order(OrderKind.APPROVE, proposal.digest())["reason"] == "it was rejected"
    assert desk.wire.runs == to_wire(GOOD)
