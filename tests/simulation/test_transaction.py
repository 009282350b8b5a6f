"""Length of a gain transaction on an idle bus: simulated time, so a fact and no measurement."""

import pytest
from bus_simulation.transaction import transaction

KEY = bytes(range(16))


@pytest.mark.parametrize(("polls", "samples"), [(1, 3.0), (2, 1.5), (4, 1.25), (10, 1.1)])
@pytest.mark.parametrize(("key", "frames"), [(None, 14), (KEY, 18)], ids=["plain", "with code"])
def test_a_transaction_takes_three_samples_or_less(polls: int, samples: float, key: bytes | None, frames: int) -> None:
    took = transaction(polls, key)
    assert 1 / polls <= took.swap_samples <= took.done_samples == pytest.approx(samples)
    assert took.frames == frames
