"""Frames on their way to a host that have exactly one thing wrong, their checksum right: one layer alone can tell."""

from random import Random

import can

from bus_simulation.bus import Way
from bus_simulation.layers.wire import ABORT, ACK, COMMIT, ITEM, LEASE, PAGE, crc8

MANTISSA_BYTES = 2  # the lowest of a float32: the number stays one
EPOCHS = 8192  # that an ACK can tell apart


def misread(way: Way, rng: Random) -> None:
    """If a whole page is about to arrive, one of its gains arrives once more, wrong, just before the page's end."""
    ends = [i for i, message in enumerate(way.inbox) if message.arbitration_id & 31 == PAGE]
    items = [message for message in way.inbox if message.arbitration_id & 31 == ITEM and len(message.data) == 8]
    if not ends or not items:
        return
    right = rng.choice(items)
    data = bytearray(right.data[:7])
    data[1 + rng.randrange(MANTISSA_BYTES)] ^= 1 << rng.randrange(8)
    way.inbox.insert(ends[-1], _whole(right.arbitration_id, data))


def of_another_epoch(way: Way, rng: Random, node: int, epoch: int, owner: int, seq: int) -> None:
    """An answer to what the host may wait for (lease, commit, fence), right but for the epoch in which it was given."""
    kind = rng.choice((LEASE, COMMIT, ABORT))
    number = owner if kind == LEASE else seq
    head = kind | ((epoch + rng.choice((-1, 1, 7))) % EPOCHS) << 11
    data = bytearray(head.to_bytes(3, "little") + number.to_bytes(2, "little") + number.to_bytes(2, "little"))
    way.inbox.append(_whole(node << 5 | ACK, data))


def _whole(id_: int, data: bytearray) -> can.Message:
    """The frame with its checksum."""
    data.append(crc8(id_, bytes(data)))
    return can.Message(arbitration_id=id_, is_extended_id=False, data=data)
