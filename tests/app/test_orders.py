"""Order files: written whole, read strictly, taken once; whatever else lies in the folder does no harm."""

import json
import os
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.errors import UserError
from retuner.schedule.gains import PidGains
from retuner.session.orders import LARGEST, MOST_AT_ONCE, Order, OrderBox, OrderKind, put_order, read_order

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
