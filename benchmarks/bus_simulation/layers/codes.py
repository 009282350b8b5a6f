"""The layer of codes: a commit is authentic over the challenge in force, and a challenge serves once."""

import hmac
import struct
from collections import deque
from collections.abc import Callable, Sequence

from bus_simulation.layers.wire import KEYED, broken

HALVES = 4


class Codes:
    """Challenges and halves of codes, as they were drawn and came.

    Parameters
    ----------
    key : the device's. draw : makes a challenge.
    """

    def __init__(self, key: bytes | None, draw: Callable[[], int]) -> None:
        self.key, self._draw = key, draw
        self.nonce = self.before = self.drawn = 0
        self._halves = (deque[bytes](maxlen=HALVES), deque[bytes](maxlen=HALVES))

    def draw(self) -> int:
        """A challenge for the device."""
        self.before, self.nonce = self.nonce, self._draw()
        self.drawn += 1
        for part in self._halves:
            part.clear()
        return self.nonce

    def take(self, data: bytes) -> None:
        """An AUTH frame came."""
        self._halves[data[0] & 15].append(data[:7])

    def code(self, nonce: int, node: int, epoch: int, owner: int, seq: int, base: int, gains: Sequence[float]) -> bytes:
        """The 96 bits of a commit over a challenge."""
        said = KEYED + struct.pack("<BHQHHH3f", node, epoch, nonce, owner, seq, base, *gains)
        return hmac.digest(self.key or b"", said, "sha256")[:12]

    def came(self, node: int, epoch: int, owner: int, seq: int, base: int, gains: Sequence[float]) -> bool:
        """Whether both halves of a commit's right code are there."""
        if self.key is None:
            return True
        code = self.code(self.nonce, node, epoch, owner, seq, base, gains)
        heads = (bytes([part | (seq & 15) << 4]) for part in (0, 1))
        return all(
            head + half in kept for head, half, kept in zip(heads, (code[:6], code[6:]), self._halves, strict=True)
        )

    def renewed(self, drawn_before: int, why: str) -> None:
        """A challenge that has served, or that a fence has made worthless, is gone."""
        if self.drawn == drawn_before:
            raise broken("codes_are_fresh", f"no new challenge after {why}")

    def told(self, data: bytes, token: int) -> None:
        """What the device says about the challenge."""
        right = bytes([token & 127 | (128 if self.key is not None else 0)]) + self.nonce.to_bytes(6, "little")
        if data[:7] != right:
            raise broken("codes_are_fresh", f"CHALLENGE says {data.hex()}, in force is {right.hex()}")
