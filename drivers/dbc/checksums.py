"""Checksums and counters in foreign messages, by the name of the algorithm.

The sum is over all bytes of the message but its own, in their order; with a data identifier this comes after them, low
byte first, as in AUTOSAR E2E. The check values (over the ASCII digits 1 to 9) are those of Greg Cook's catalogue of
parametrised CRC algorithms.
"""

from collections.abc import Callable, Iterable
from functools import reduce
from operator import xor

BYTE, WORD = 0xFF, 0xFFFF


def _crc(data: Iterable[int], bits: int, polynomial: int, start: int, end: int) -> int:
    top, mask, crc = 1 << (bits - 1), (1 << bits) - 1, start
    for byte in data:
        crc ^= byte << (bits - 8)
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc & top else crc << 1) & mask
    return crc ^ end


ALGORITHMS: dict[str, Callable[[bytes], int]] = {
    "sum8": lambda data: sum(data) & BYTE,
    "sum8_inverted": lambda data: ~sum(data) & BYTE,
    "sum8_negated": lambda data: -sum(data) & BYTE,
    "xor8": lambda data: reduce(xor, data, 0),
    "crc8": lambda data: _crc(data, 8, 0x07, 0x00, 0x00),
    "crc8_sae_j1850": lambda data: _crc(data, 8, 0x1D, BYTE, BYTE),
    "crc8_autosar": lambda data: _crc(data, 8, 0x2F, BYTE, BYTE),
    "crc16_ccitt": lambda data: _crc(data, 16, 0x1021, WORD, 0),
    "crc16_xmodem": lambda data: _crc(data, 16, 0x1021, 0, 0),
}
"""Every algorithm by its name."""
