"""What a device is at a moment, as its bench shows it; and everything that passes its door, in the order of layers."""

from typing import NamedTuple

import can

from bus_simulation.layers.wire import broken
from retuner.drivers.controller.gain_memory import GainSet
from retuner.drivers.controller.virtual_device import VirtualDevice


class Seen(NamedTuple):
    """A device between two frames."""

    running: GainSet
    confirmed: GainSet
    latest: int
    has_staged: bool
    owner: int
    refused: int
    sample: int
    epoch: int
    sp: float
    load: float
    auto: bool


def look(device: VirtualDevice) -> Seen:
    """As it is now."""
    pages = device.pages
    return Seen(
        pages.running, pages.confirmed, pages.latest, pages.has_staged, device.lease.owner, device.refused,
        device.sample, device.epoch, device.sp, device.load, device.auto,
    )  # fmt: skip


def unchanged(layer: str, before: Seen, after: Seen, *but: str) -> None:
    """Nothing else than this may have changed."""
    if before == after:
        return
    for name, old, new in zip(Seen._fields, before, after, strict=True):
        if old != new and name not in but:
            raise broken(layer, f"{name} went from {old} to {new}")


class Told(NamedTuple):
    """A frame that reached the device, what it answered, and how it was before and after."""

    command: int
    data: bytes
    replies: list[bytes]
    before: Seen
    after: Seen

    @classmethod
    def of(cls, message: can.Message, replies: list[can.Message], before: Seen, after: Seen) -> "Told":
        """The same as bytes."""
        answers = [bytes(reply.data) for reply in replies]
        return cls(message.arbitration_id & 31, bytes(message.data), answers, before, after)
