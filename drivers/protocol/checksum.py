"""The checks on frames and gain sets.

Frames: CRC-8 SAE J1850 (polynomial 0x1D, start 0xFF, final exclusive-or 0xFF), the CRC of AUTOSAR E2E profile 1, over
the frame's id and the bytes before it, so that a frame under a wrong id fails as well. Sets: CRC-32 (zlib) over
everything that makes a set the right one: node, epoch, sequence and the gains as they stand on the wire. A commit
continues it over the sequence that it was built on and over the owner of the lease. Samples: CRC-16-CCITT (0x1021,
start 0xFFFF), the CRC of AUTOSAR E2E profile 5, over node and the fields of both halves, so that halves of two
samples or two nodes never make one. The same CRC-16 stamps a request for the lease with the device's own time.
"""

import binascii
import struct
import zlib
from collections.abc import Iterable

from retuner.drivers.protocol.frames import TelemetryPv, TelemetrySp
from retuner.schedule.gains import PidGains

POLYNOMIAL = 0x1D
FLOAT32_MAX = 3.4028234663852886e38
CO_STEP = 0.0001  # percent, resolution of co on the wire
_SAMPLE = struct.Struct("<BBfiBfBbB")
_STAMP = struct.Struct("<HI")
STAMP_SAMPLES = 64  # controller samples that share a stamp


def crc(data: Iterable[int], bits: int, polynomial: int, start: int, end: int) -> int:
    """A CRC of 8 bits or more. start : what the register holds at first. end : final exclusive-or."""
    top, mask, found = 1 << (bits - 1), (1 << bits) - 1, start
    for byte in data:
        found ^= byte << (bits - 8)
        for _ in range(8):
            found = ((found << 1) ^ polynomial if found & top else found << 1) & mask
    return found ^ end


_TABLE = bytes(crc((byte,), 8, POLYNOMIAL, 0, 0) for byte in range(256))


def crc8(data: bytes | bytearray) -> int:
    """CRC-8 SAE J1850 of data (0x4B for b'123456789')."""
    found = 0xFF
    for byte in data:
        found = _TABLE[found ^ byte]
    return found ^ 0xFF


def frame_crc(arbitration_id: int, payload: bytes | bytearray) -> int:
    """Checksum of a frame whose bytes before the checksum are payload."""
    return crc8(struct.pack("<H", arbitration_id) + payload)


def to_wire(gains: PidGains) -> PidGains:
    """The gains as a float32 controller holds them.

    Raises ValueError: a gain is too large for float32, or all of them are too small for it.
    """
    if max(abs(gains.kp), abs(gains.ki), abs(gains.kd)) > FLOAT32_MAX:
        raise ValueError(f"{gains} does not fit float32, whose largest number is {FLOAT32_MAX:.4g}")
    kp, ki, kd = struct.unpack("<fff", struct.pack("<fff", gains.kp, gains.ki, gains.kd))
    return PidGains(kp, ki, kd)


def set_crc(node: int, epoch: int, seq: int, gains: PidGains) -> int:
    """CRC-32 of a gain set; the gains must be float32 values (to_wire)."""
    return zlib.crc32(struct.pack("<BHHfff", node, epoch, seq, gains.kp, gains.ki, gains.kd))


def page_crc(set_crc_: int, token: int) -> int:
    """CRC-32 of a read-back: the set's, continued over the token of the question that it answers."""
    return zlib.crc32(struct.pack("<H", token), set_crc_)


def commit_crc(set_crc_: int, base: int, owner: int) -> int:
    """CRC-32 of a commit: the set's, continued over the sequence it is built on and the owner of the lease."""
    return zlib.crc32(struct.pack("<HH", base, owner), set_crc_)


def co_steps(co: float) -> int:
    """Controller output in percent as the whole number of CO_STEP that travels."""
    return round(co / CO_STEP)


def sample_crc(node: int, pv: TelemetryPv, sp: TelemetrySp) -> int:
    """CRC-16 of a sample: node, then counter, pv, co of the first half, then counter, sp, mode, limited, running."""
    return binascii.crc_hqx(
        _SAMPLE.pack(node, pv.counter, pv.pv, co_steps(pv.co), sp.counter, sp.sp, sp.mode, sp.limited, sp.running),
        0xFFFF,
    )


def lease_stamp(epoch: int, sample: int) -> int:
    """CRC-16 of the time of a request for the lease: boot epoch and the device's sample counter in STAMP_SAMPLES."""
    return binascii.crc_hqx(_STAMP.pack(epoch, sample // STAMP_SAMPLES), 0xFFFF)
