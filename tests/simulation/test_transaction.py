"""A gain transaction takes at most ten samples on an idle bus: simulated time, so a fact and no measurement."""

import pytest
from bus_simulation.transaction import transaction

KEY = bytes(range(16))


@pytest.mark.parametrize("polls", [1, 2, 4, 10])
@pytest.mark.parametrize("key", [None, KEY], ids=["plain", "with code"])
def test_a_transaction_takes_at_most_ten_samples(polls: int, key: bytes | None) -> None:
    took = transaction(polls, key)
    assert 0 < took.swap_samples <= took.done_samples <= 10
    assert took.swap_samples >= 1 / polls
