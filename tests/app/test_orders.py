"""Order files: written whole, read strictly, taken once; whatever else lies in the folder does no harm."""

import json
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire import GOOD, PROMISE, Wire

from retuner.adaptive.orders.pending_proposal import Proposal
from retuner.adaptive.supervision.decision import Action, Decision, Mode, Outcome
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.drivers.protocol.checksum import to_wire
from retuner.errors import UserError
from retuner.schedule.gains import PidGains
from retuner.session.ledger_rows import feed
from retuner.session.order_queue import Before, OrderDesk, OrderState
from retuner.session.orders import LARGEST, MOST_AT_ONCE, REGIONAL, Order, OrderBox, OrderKind, put_order, read_order

HASH = "0123456789abcdef" * 4
APPROVE = Order(OrderKind.APPROVE, "Ada", "2030-01-31T12:00:00Z", "as discussed", digest=HASH)
REVERT = Order(OrderKind.REVERT, "Ada", "2030-01-31T12:00:01Z", decision=3)
UNLOCK = Order(OrderKind.UNLOCK, "Ada", "2030-01-31T12:00:02Z", region="low")
REJECT = Order(OrderKind.REJECT, "Ada", "2030-01-31T12:00:03Z", digest=HASH)
HOLD = Order(OrderKind.MODE, "Ada", "2030-01-31T12:00:04Z", mode="off")

PROPOSE = Order(OrderKind.PROPOSE, "Ada", "2030-01-31T12:00:05Z", region="low", gains=PidGains(2.0, 0.1))


@pytest.mark.parametrize("order", [APPROVE, REVERT, UNLOCK, REJECT, HOLD, PROPOSE])
def test_an_order_comes_back_as_it_was_given(tmp_path: Path, order: Order) -> None:
    path = put_order(tmp_path, order)
    assert read_order(path) == order
    (found,) = OrderBox(tmp_path).take()
    assert (found.name, found.order, found.refused) == (path.name, order, "")


def test_orders_are_taken_once_in_their_order_and_put_away(tmp_path: Path) -> None:
    box = OrderBox(tmp_path)
    assert box.take() == []
    for order in (UNLOCK, REVERT, APPROVE, APPROVE):
        put_order(tmp_path, order)
    assert [found.order for found in box.take()] == [APPROVE, APPROVE, REVERT, UNLOCK]
    assert [found for _ in range(100) for found in box.take()] == []
    assert len(list((tmp_path / "orders" / "taken").iterdir())) == 4
    assert OrderBox(tmp_path).take() == []
    put_order(tmp_path, APPROVE)
    late = [found for _ in range(40) for found in box.take()]
    assert [found.order for found in late] == [APPROVE]


def test_a_file_within_the_same_tick_of_the_clock_is_seen_all_the_same(tmp_path: Path) -> None:
    box = OrderBox(tmp_path)
    put_order(tmp_path, APPROVE)
    box.take()
    folder = tmp_path / "orders"
    stamp = folder.stat().st_mtime_ns
    box.take()
    put_order(tmp_path, REVERT)
    os.utime(folder, ns=(stamp, stamp))
    assert [found.order for _ in range(40) for found in box.take()] == [REVERT]


def test_many_files_are_taken_in_turns(tmp_path: Path) -> None:
    for _ in range(MOST_AT_ONCE + 3):
        put_order(tmp_path, UNLOCK)
    box = OrderBox(tmp_path)
    assert len(box.take()) == MOST_AT_ONCE
    assert len(box.take()) == 3


def test_what_another_session_has_dealt_with_is_passed_over(tmp_path: Path) -> None:
    done = put_order(tmp_path, APPROVE)
    put_order(tmp_path, REVERT)
    assert [found.order for found in OrderBox(tmp_path, {done.name}).take()] == [REVERT]


def test_a_file_that_cannot_be_put_away_is_taken_once(tmp_path: Path) -> None:
    put_order(tmp_path, APPROVE)
    (tmp_path / "orders" / "taken").write_text("not a folder")
    box = OrderBox(tmp_path)
    assert len(box.take()) == 1
    assert [found for _ in range(40) for found in box.take()] == []


@given(st.binary(max_size=300))
def test_bytes_that_are_no_order_are_one_line(tmp_path_factory: pytest.TempPathFactory, raw: bytes) -> None:
    folder = tmp_path_factory.mktemp("orders")
    (folder / "orders").mkdir()
    (folder / "orders" / "x.json").write_bytes(raw)
    (found,) = OrderBox(folder).take()
    assert found.order is None
    assert found.refused
    assert "\n" not in found.refused
    assert (folder / "orders" / "refused" / "x.json").read_bytes() == raw


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@given(st.sampled_from([APPROVE, REVERT, UNLOCK, PROPOSE]), st.sampled_from(sorted(PROPOSE.to_dict())), JSON)
def test_a_field_of_another_kind_is_refused_or_is_an_order_all_the_same(order: Order, name: str, value: Any) -> None:
    body = {**order.to_dict(), name: value}
    with suppress(ValueError):
        read = Order.from_dict(body)
        assert read.to_dict() == body
        assert type(read.to_dict()[name]) is type(order.to_dict()[name])
        return
    with pytest.raises(ValueError, match=r"must|empty"):
        Order.from_dict(body)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"order": "fire"}, "order must be"),
        ({"by": " "}, "by is empty"),
        ({"by": "a" * 201}, "by must be at most"),
        ({"note": "two\nlines"}, "note must be"),
        ({"at": "yesterday"}, "at must be"),
        ({"digest": "12"}, "digest must"),
        ({"decision": 10**10}, "decision must be"),
        ({"decision": -1}, "decision"),
        ({"decision": True}, "decision must be a whole number"),
        ({"extra": 1}, "fields must be"),
        ({"order": "revert"}, "decision must be the number"),
        ({"order": "unlock"}, "region must name"),
    ],
)
def test_every_field_is_looked_at(change: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Order.from_dict({**APPROVE.to_dict(), **change})


def test_no_plain_file_is_opened(tmp_path: Path) -> None:
    orders = tmp_path / "orders"
    orders.mkdir()
    os.mkfifo(orders / "pipe.json")
    (orders / "link.json").symlink_to("/dev/zero")
    (orders / "huge.json").write_bytes(b"[" * (LARGEST + 1))
    (orders / ".being-written.tmp").write_text("{")
    told = {found.name: found.refused for found in OrderBox(tmp_path).take()}
    assert told["pipe.json"] == told["link.json"] == "is no plain file"
    assert "an order has at most" in told["huge.json"]
    assert ".being-written.tmp" not in told
    assert (orders / ".being-written.tmp").exists()


def give_all(folder: Path, person: str, count: int, begin: Callable[[], object]) -> list[str]:
    """Give so many orders of one moment; the names of their files."""
    begin()
    orders = (Order(OrderKind.MODE, person, HOLD.at, f"{number}", mode="off") for number in range(count))
    return [put_order(folder, order).name for order in orders]


def all_that_arrive(folder: Path) -> list[tuple[str, str]]:
    box = OrderBox(folder)
    orders = [found.order for _ in range(200) for found in box.take()]
    return sorted((order.by, order.note) for order in orders if order is not None)


def test_no_order_of_several_threads_in_one_second_is_lost(tmp_path: Path) -> None:
    for attempt in range(3):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        people, barrier = [f"person {i}" for i in range(4)], threading.Barrier(4)
        with ThreadPoolExecutor(4) as pool:
            given = [pool.submit(give_all, folder, person, 8, barrier.wait) for person in people]
            names = [name for one in given for name in one.result()]
        assert len(set(names)) == len(names) == 32
        assert all_that_arrive(folder) == sorted((person, str(i)) for person in people for i in range(8))


def test_no_order_of_several_processes_in_one_second_is_lost_while_they_are_taken(tmp_path: Path) -> None:
    people, box = [f"person {i}" for i in range(4)], OrderBox(tmp_path)
    with ProcessPoolExecutor(4) as pool:
        given = [pool.submit(give_all, tmp_path, person, 15, int) for person in people]
        taken = []
        while not all(one.done() for one in given):
            taken += box.take()
        names = [name for one in given for name in one.result()]
    taken += [found for _ in range(200) for found in box.take()]
    assert len(set(names)) == len(names) == 60
    found = sorted((one.order.by, one.order.note) for one in taken if one.order is not None)
    assert found == sorted((person, str(i)) for person in people for i in range(15))
    assert [one.refused for one in taken if one.refused] == []


def test_a_thousand_orders_of_one_second_are_enough(tmp_path: Path) -> None:
    orders = tmp_path / "orders"
    orders.mkdir()
    for i in range(1, 1000):
        (orders / f"20300131T120000Z-approve-{i:03d}-0.json").touch()
    with pytest.raises(UserError, match="wait a second"):
        put_order(tmp_path, APPROVE)


def test_what_is_written_is_readable_json(tmp_path: Path) -> None:
    assert json.loads(put_order(tmp_path, REVERT).read_text())["decision"] == 3


# Orders that meet a trial: each ends it, lets it be, or is told why not; none is for another set than it names.


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
