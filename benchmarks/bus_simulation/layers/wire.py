"""Frames and their checks taken apart by hand, from docs/developers/protocol.md, without code of host or device.

A mistake in the shipped codec or checksums is one in both ends, so neither of them would notice.
"""

import binascii
import hmac
import math
import struct
import zlib
from collections import deque
from collections.abc import Callable, Sequence

import can

from bus_simulation.truth import ViolationError

LEASE, READ, ABORT, STAGE, COMMIT, STORE, CONFIRM, SETPOINT, MODE, LOAD, AUTH = range(1, 12)
HEARTBEAT, STATUS, TELEMETRY_PV, TELEMETRY_SP, IDENTITY, ITEM, PAGE, ACK, CHALLENGE = range(16, 25)
LENGTHS = {
    LEASE: 8, READ: 4, ABORT: 3, STAGE: 8, COMMIT: 8, STORE: 8, CONFIRM: 5, SETPOINT: 8, MODE: 8, LOAD: 8, AUTH: 8
}  # fmt: skip
UNCHECKED = {COMMIT, TELEMETRY_PV, TELEMETRY_SP}  # these end in another checksum
VALUE_MAX, SP_MAX, LOAD_MAX = 1e12, 1e9, 1e3
CO_RANGE = (-1_000_000, 2_000_000)  # 0.0001 %
STAMP_SAMPLES = 64
KEYED = b"retuner commit 2"


def broken(layer: str, text: str) -> ViolationError:
    """A layer does not what the page says."""
    return ViolationError(f"{layer}: {text}")


def _shifted(byte: int) -> int:
    """What eight shifts make of a byte, polynomial 0x1D."""
    for _ in range(8):
        byte = byte << 1 & 0xFF ^ (0x1D if byte & 0x80 else 0)
    return byte


_SHIFTED = bytes(map(_shifted, range(256)))


def crc8(id_: int, data: bytes) -> int:
    """CRC-8 SAE J1850 over the identifier, low byte first, and the bytes."""
    crc = _SHIFTED[_SHIFTED[0xFF ^ id_ & 0xFF] ^ id_ >> 8 & 0xFF]
    for byte in data:
        crc = _SHIFTED[crc ^ byte]
    return crc ^ 0xFF


def is_foreign(message: can.Message, node: int) -> bool:
    """Whether it is of another node."""
    return message.arbitration_id >> 5 != node


def is_whole(message: can.Message) -> bool:
    """Whether a frame to a device has the right kind, length and checksum, and numbers in their ranges."""
    command, data = message.arbitration_id & 31, bytes(message.data)
    if message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd:
        return False
    if LENGTHS.get(command) != len(data):
        return False
    return (command in UNCHECKED or data[-1] == crc8(message.arbitration_id, data[:-1])) and _in_range(command, data)


def _in_range(command: int, data: bytes) -> bool:
    """The ranges of the DBC."""
    match command:
        case 1:
            return data[:2] != b"\0\0"
        case 2:
            return data[0] <= 4
        case 4:
            return data[0] & 3 < 3 and _within(data[1:5], VALUE_MAX)
        case 7:
            return data[2:4] != b"\0\0"
        case 8 | 10:
            return _within(data[1:5], SP_MAX if command == SETPOINT else LOAD_MAX) and data[5:7] != b"\0\0"
        case 9:
            co = int.from_bytes(data[2:5], "little", signed=True)
            return data[1] <= 1 and CO_RANGE[0] <= co <= CO_RANGE[1] and data[5:7] != b"\0\0"
        case 11:
            return data[0] & 15 <= 1
        case _:
            return True


def _within(data: bytes, limit: float) -> bool:
    """Whether a float32 is finite and inside."""
    value = float32(data)
    return math.isfinite(value) and abs(value) <= limit


def float32(data: bytes) -> float:
    """Four bytes, low one first."""
    return float(struct.unpack("<f", data)[0])


def u16(data: bytes) -> int:
    """Two bytes, low one first."""
    return int.from_bytes(data[:2], "little")


def newer(number: int, than: int, bits: int = 16) -> bool:
    return 0 < (number - than) % (1 << bits) < 1 << bits - 1


def set_crc(node: int, epoch: int, seq: int, gains: Sequence[float], more: bytes) -> int:
    """CRC-32 of a set, continued over more."""
    return zlib.crc32(struct.pack("<BHH3f", node, epoch, seq, *gains) + more)


def stamp(epoch: int, sample: int) -> int:
    """Stamp of a device's time, for the lease."""
    return binascii.crc_hqx(struct.pack("<HI", epoch, sample // STAMP_SAMPLES), 0xFFFF)


def sample_crc(node: int, pv: bytes, sp: bytes) -> int:
    """CRC-16 over the two halves of a sample as they travel."""
    co = int.from_bytes(pv[5:8], "little", signed=True)
    limited = (sp[5] >> 1 & 3) - (4 if sp[5] >> 1 & 2 else 0)
    said = bytes([node]) + pv[:5] + struct.pack("<i", co) + sp[:5] + struct.pack("<BbB", sp[5] & 1, limited, sp[5] >> 3)
    return binascii.crc_hqx(said, 0xFFFF)


class Ack:
    """An ACK taken apart."""

    def __init__(self, data: bytes) -> None:
        head = int.from_bytes(data[:3], "little")
        self.kind, self.item, self.reason, self.epoch = head & 15, head >> 4 & 3, head >> 6 & 31, head >> 11 & 0x1FFF
        self.seq, self.latest = u16(data[3:]), u16(data[5:])


# ---- The layer of codes: a commit is authentic over the challenge in force, and a challenge serves once

HALVES = 4


class Codes:
    """Challenges and halves of codes, as they were drawn and came.

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
