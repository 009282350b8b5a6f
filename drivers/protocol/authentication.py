"""The code that authenticates a commit: HMAC-SHA-256 (RFC 2104, FIPS 180-4), its first 96 bits in two AUTH frames.

It covers the node, the boot epoch, the device's challenge, the owner of the lease, the sequence numbers and the gains
as they stand on the wire. The challenge (48 random bits, new at boot, after every accepted commit and every fence)
makes it fresh, so nothing needs to be remembered over a restart against replay. 96 bits: of all the tries that a full
bus has room for in a hundred years (5e12) one is right with a chance of 1e-15. So wrong codes lock nobody out: a lock
would be a way for strangers to keep the owner of the key from putting a verified set back.
"""

import hmac
import secrets
import struct
from collections import deque
from collections.abc import Callable

from retuner.drivers.protocol.frames import Auth, Reason
from retuner.schedule.gains import PidGains

HALF_BITS = 48
NONCE_BITS = 48
HALF = (1 << HALF_BITS) - 1
SEQ_TAG = 16  # AUTH carries the sequence modulo this
HALVES_KEPT = 4  # of each part: a forged half does not displace the right one


def commit_code(key: bytes, node: int, epoch: int, nonce: int, owner: int, seq: int, base: int, gains: PidGains) -> int:
    """The 96 bits of a commit; gains as float32 values (checksum.to_wire)."""
    said = struct.pack("<BHQHHHfff", node, epoch, nonce, owner, seq, base, gains.kp, gains.ki, gains.kd)
    return int.from_bytes(hmac.digest(key, b"retuner commit 2" + said, "sha256")[:12], "little")


def code_frames(code: int, seq: int) -> list[Auth]:
    """The two frames that carry a code ahead of its commit."""
    return [Auth(part, seq % SEQ_TAG, code >> part * HALF_BITS & HALF) for part in (0, 1)]


def fresh_nonce() -> int:
    """A challenge that nobody can foresee."""
    return secrets.randbits(NONCE_BITS)


class CodeDesk:
    """The device's side: the challenge, the halves of codes that have come, and the count of wrong codes.

    key : shared secret; None when commits need no code.
    nonce : makes challenges.
    """

    def __init__(self, key: bytes | None, nonce: Callable[[], int] = fresh_nonce) -> None:
        self._key, self._make = key, nonce
        self.boot()

    @property
    def demanded(self) -> bool:
        """Whether commits need a code."""
        return self._key is not None

    def boot(self) -> None:
        """Restart: a new challenge."""
        self.wrong = 0
        self.renew()

    def renew(self) -> None:
        """A number was fenced off: a code made for it must be worth nothing, even if the number comes round again."""
        self.nonce = self._make()
        self._halves: tuple[deque[Auth], deque[Auth]] = (deque(maxlen=HALVES_KEPT), deque(maxlen=HALVES_KEPT))

    def take(self, frame: Auth) -> None:
        """Note half a code; the newest HALVES_KEPT of each part stay."""
        self._halves[frame.part].append(frame)

    def judge(self, node: int, epoch: int, owner: int, seq: int, base: int, gains: PidGains) -> Reason:
        """Whether the code of this commit has come, both halves of it, whatever other halves came beside them."""
        if self._key is None:
            return Reason.OK
        low, high = ([half.mac for half in part if half.seq == seq % SEQ_TAG] for part in self._halves)
        if not (low and high):
            return Reason.NO_CODE
        right = commit_code(self._key, node, epoch, self.nonce, owner, seq, base, gains)
        if _among(right & HALF, low) and _among(right >> HALF_BITS, high):
            self.renew()
            return Reason.OK
        self.wrong += 1
        return Reason.WRONG_CODE


def _among(right: int, halves: list[int]) -> bool:
    """Whether this half is there, in a time that does not tell how nearly."""
    wanted, found = right.to_bytes(HALF_BITS // 8, "little"), False
    for half in halves:
        found |= hmac.compare_digest(half.to_bytes(HALF_BITS // 8, "little"), wanted)
    return found
