"""A link on which a controller answers at once."""

from typing import Any

import can

from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.device import LinkState


def nothing(message: can.Message) -> bool:
    del message
    return False


class Wire:
    """A link on which the node answers at once; `lost` says which frames never arrive."""

    settings, state = LinkSettings(), LinkState.UP

    def __init__(self, node: Any) -> None:
        self.node = node
        self.waiting: list[can.Message] = []
        self.sent: list[can.Message] = []
        self.noted: list[can.Message] = []
        self.lost = nothing

    def send(self, message: can.Message) -> bool:
        self.sent.append(message)
        if not self.lost(message):
            self.waiting += self.node.receive(message)
        return True

    def note(self, message: can.Message) -> None:
        self.noted.append(message)

    def receive_all(self) -> list[can.Message]:
        waiting, self.waiting = self.waiting, []
        return [message for message in waiting if not self.lost(message)]
