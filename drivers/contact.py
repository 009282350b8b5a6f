"""How long nothing has been heard of a device, and whether that is too long."""

from retuner.drivers.device import LinkState


class Contact:
    """Ages of one node's frames.

    Parameters
    ----------
    silent_s : age of the last frame at which the node counts as silent, s.
    connect_s : how long the first connection may take, s.
    """

    def __init__(self, silent_s: float, connect_s: float) -> None:
        self._silent_s, self._connect_s = silent_s, connect_s
        self._first_poll_s = float("inf")
        self.heard_s = float("-inf")
        self.made = False  # whether there has ever been a connection

    def polled(self, now_s: float) -> None:
        """The host looks."""
        self._first_poll_s = min(self._first_poll_s, now_s)

    def lost(self, now_s: float, link: LinkState) -> str:
        """Why the device is out of reach, or an empty string."""
        if link is LinkState.DOWN:
            return "the bus is gone"
        age_s = now_s - self.heard_s
        return f"no frame for {age_s:.3g} s" if age_s > self._silent_s else ""

    def in_vain(self, now_s: float) -> bool:
        """Whether the first connection takes too long."""
        return not self.made and now_s - self._first_poll_s > self._connect_s
