"""The code that authenticates a commit: HMAC-SHA-256 (RFC 2104, FIPS 180-4), its first 96 bits in two AUTH frames.

It covers the node, the boot epoch, the device's challenge, the owner of the lease, the sequence numbers and the gains
as they stand on the wire. The challenge (48 random bits, new after every commit and fence) makes it fresh, so
nothing needs to be remembered over a restart against replay. 96 bits: a guess is right once in 8e28, and DESK_TRIES
wrong ones lock commits out, longer every time, also over a restart.
"""

import hmac
import secrets
import struct
from collections.abc import Callable

from retuner.drivers.protocol.frames import Auth, Reason
from retuner.schedule.gains import PidGains

HALF_BITS = 48
NONCE_BITS = 48
HALF = (1 << HALF_BITS) - 1
SEQ_TAG = 16  # AUTH carries the sequence modulo this
KEY_BYTES_MIN = 16
DESK_TRIES = 3  # wrong codes after which commits are locked out
LOCK_DOUBLINGS_MAX = 8


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
    """The device's side: challenge, the code that has come, the count of wrong ones and the lock-out.

    Parameters
    ----------
    key : shared secret; None when commits need no code.
    lock_samples : controller samples of the first lock-out; doubled with every further one.
    nonce : makes challenges.
    """

    def __init__(self, key: bytes | None, lock_samples: int, nonce: Callable[[], int] = fresh_nonce) -> None:
        self._key, self._lock_samples, self._make = key, lock_samples, nonce
        self.wrong = 0  # kept over a restart, as in non-volatile memory
        self._left = 0
        self._parts: dict[int, Auth] = {}
        self.boot()

    @property
    def demanded(self) -> bool:
        """Whether commits need a code."""
        return self._key is not None

    @property
    def locked(self) -> bool:
        """Whether commits are locked out."""
        return self._left > 0

    def boot(self) -> None:
        """Restart: a new challenge, and the lock-out begins anew, so that restarting does not shorten it."""
        self.renew()
        if self.wrong >= DESK_TRIES:
            self._lock()

    def renew(self) -> None:
        """A number was fenced off: a code made for it must be worth nothing, even if the number comes round again."""
        self.nonce = self._make()
        self._parts = {}

    def tick(self) -> None:
        """One controller sample has passed."""
        self._left = max(self._left - 1, 0)

    def take(self, frame: Auth) -> None:
        """Note half a code."""
        self._parts[frame.part] = frame

    def judge(self, node: int, epoch: int, owner: int, seq: int, base: int, gains: PidGains) -> Reason:
        """Whether the code that has come is that of this commit; used up either way."""
        if self._key is None:
            return Reason.OK
        if self.locked:
            return Reason.LOCKED
        parts, self._parts = self._parts, {}
        if set(parts) != {0, 1} or any(part.seq != seq % SEQ_TAG for part in parts.values()):
            return Reason.NO_CODE
        right = commit_code(self._key, node, epoch, self.nonce, owner, seq, base, gains)
        self.nonce = self._make()
        got = parts[0].mac | parts[1].mac << HALF_BITS
        if hmac.compare_digest(got.to_bytes(12, "little"), right.to_bytes(12, "little")):
            self.wrong = 0
            return Reason.OK
        self.wrong += 1
        if self.wrong >= DESK_TRIES:
            self._lock()
        return Reason.WRONG_CODE

    def _lock(self) -> None:
        """Lock commits out, twice as long for every wrong code beyond the tries."""
        self._left = self._lock_samples << min(self.wrong - DESK_TRIES, LOCK_DOUBLINGS_MAX)
