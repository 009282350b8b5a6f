"""Mutants of good inputs: bytes flipped, cut, repeated, swapped, and pieces that have broken parsers before."""

import random
from collections.abc import Iterator

PIECES = (
    b"nan", b"inf", b"-inf", b"1e400", b"-1e400", b"1e-400", b"1_000", b"\xd9\xa1", b"true", b"0x7f", b"1" * 400, b"",
    b"-0.0", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\xf0\x9f\x92\xa9", b"\r", b"\n", b"\n\n",
    b"\t", b" " * 300, b'"', b"'", b'"""', b"[", b"]", b"[[", b"{", b"}", b"[" * 3000, b"=", b",", b";", b"#", b"\\",
    b"\x1b[2J", b"=cmd()", b"1979-05-27", b"../../x", b"<script>", b"a" * 200_000,
)  # fmt: skip
"""Numbers that are none, digits of other scripts, halves of characters, open brackets and quotes, escapes, too long."""


def mutant(good: bytes, rng: random.Random) -> bytes:
    """One to four changes of a good input."""
    data = bytearray(good)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at, length = rng.randrange(len(data) + 1), rng.choice((1, 1, 2, 4, 16, 64))
        match rng.randrange(8):
            case 0 if at < len(data):
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                data[at : at + length] = rng.randbytes(length)
            case 2:
                del data[at : at + length]
            case 3:
                data[at:at] = data[at : at + length]
            case 4:
                data[at:at] = rng.choice(PIECES)
            case 5:
                data[at : at + length] = rng.choice(PIECES)
            case 6:
                other = rng.randrange(len(data) + 1)
                data[at:at] = data[other : other + length]
            case _:
                del data[at:]
    return bytes(data)


def cuts(good: bytes) -> Iterator[bytes]:
    return (good[:kept] for kept in range(len(good)))
