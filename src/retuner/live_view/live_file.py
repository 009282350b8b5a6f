"""The live file of a loop: what a session writes for whoever watches it from another process, and nothing waits there.

    head    64 KiB   what does not change: a JSON document       state   64 KiB   what was seen last: another one
    rings            samples as 64-bit floats; ring 0 has every sample, each further one two of eight (the least and the
                     greatest pv) of the ring before it, so every ring reaches four times as far back as the one before

The writer writes where it stands and never reads; a reader takes what is there and throws away what was overwritten
meanwhile. A document carries its CRC-32, a ring its count, written after the samples. Nothing is put on disk for good:
this is a window, the ledger is the record.
"""

import errno
import json
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from retuner.adaptive.signals.sample import FloatArray

MAGIC = b"retuner live 1\n\0"
SLOT = 65536  # Bytes of the head and of the state
RING = 32768  # samples in a ring
RINGS = 7  # Rings: at 50 samples a second the first one reaches back 11 minutes and the last one a month
BLOCK = 8  # samples of a ring of which two go on into the next
FIELDS = ("t", "sp", "pv", "co", "region", "limited", "kp", "ki", "kd")
"""t in s, sp and pv in pv units, co in percent, region as index (-1: not known), gains in parallel form."""
SAMPLE = struct.Struct(f"<{len(FIELDS)}d")
DOCUMENT = struct.Struct("<II")
COUNT = struct.Struct("<Q")
COUNTS = len(MAGIC)  # Where the rings' counts stand
HEAD = 512
STATE = SLOT
SAMPLES = 2 * SLOT
TRIES = 4  # Looks at a document that is being written, before it is taken for not there

Row = tuple[float, ...]


class LiveFileError(Exception):
    """A file is no live file, or cannot be read."""


def place(ring: int, number: int) -> int:
    """Where in the file a sample stands."""
    return SAMPLES + (ring * RING + number % RING) * SAMPLE.size


class LiveWriter:
    """Writes one.

    path : a new file. head : the document that does not change.

    Raises OSError: the file cannot be made. Later, nothing is raised: `trouble` says why nothing more is written.
    """

    def __init__(self, path: Path, head: Mapping[str, object]) -> None:
        if not hasattr(os, "pwrite"):
            raise OSError(errno.ENOSYS, "this system cannot write inside a file: no watching from outside")
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        self.trouble = ""
        self._counts = [0] * RINGS
        self._blocks: list[list[Row]] = [[] for _ in range(RINGS)]
        self._write(_document(head), HEAD)
        self._write(MAGIC, 0)

    def sample(self, row: Row) -> None:
        """A sample, by FIELDS."""
        if not self.trouble:
            self._into(0, row)

    def state(self, document: Mapping[str, object]) -> None:
        """What was seen last; one that is too large is not told."""
        if not self.trouble:
            self._write(_document(document), STATE)

    def close(self) -> None:
        """Close the file; more than once does no harm."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
            self.trouble = self.trouble or "closed"

    def _into(self, ring: int, row: Row) -> None:
        number = self._counts[ring]
        self._counts[ring] = number + 1
        self._write(SAMPLE.pack(*row), place(ring, number))
        self._write(COUNT.pack(number + 1), COUNTS + ring * COUNT.size)
        if ring + 1 < RINGS:
            block = self._blocks[ring]
            block.append(row)
            if len(block) == BLOCK:
                # the samples of the least and the greatest pv, in the order of time
                pvs = [one[2] for one in block]
                chosen = {pvs.index(min(pvs)), pvs.index(max(pvs))}
                for kept in [block[i] for i in sorted(chosen | ({BLOCK - 1} if len(chosen) == 1 else set()))]:
                    self._into(ring + 1, kept)
                block.clear()

    def _write(self, raw: bytes, at: int) -> None:
        if self.trouble:
            return
        try:
            os.pwrite(self._file, raw, at)
        except OSError as error:
            self.trouble = error.strerror or str(error)


def _document(document: Mapping[str, object]) -> bytes:
    """The document's bytes with length and check sum; nothing where they do not fit."""
    raw = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    return DOCUMENT.pack(len(raw), zlib.crc32(raw)) + raw if len(raw) <= SLOT - HEAD - DOCUMENT.size else b""


class Fresh(NamedTuple):
    """New samples: their table, shape (n, FIELDS), the number of the next one, and whether some were missed."""

    table: FloatArray
    following: int
    missed: bool


class LiveReader:
    """Reads one, while it is written or afterwards. Raises LiveFileError: it is no live file of this release."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = os.open(path, os.O_RDONLY)
        except OSError as error:
            raise LiveFileError(f"{path}: {error.strerror}") from None
        head = self._document(HEAD) if os.pread(self._file, len(MAGIC), 0) == MAGIC else None
        if head is None:
            self.close()
            raise LiveFileError(f"{path}: is no live file of this release")
        self.head: dict[str, Any] = head

    def state(self) -> dict[str, Any]:
        """What was seen last; empty before anything was."""
        return self._document(STATE) or {}

    def mark(self) -> bytes:
        """Length and check sum of what was seen last: the same mark, nothing new in `state`."""
        return os.pread(self._file, DOCUMENT.size, STATE)

    def counts(self) -> list[int]:
        """Samples that ever went into each ring."""
        raw = os.pread(self._file, RINGS * COUNT.size, COUNTS)
        return [COUNT.unpack_from(raw, i * COUNT.size)[0] for i in range(RINGS)]

    def since(self, number: int) -> Fresh:
        """The samples from this number on, as many as are still there."""
        count = self.counts()[0]
        if number >= count:
            return Fresh(np.empty((0, len(FIELDS))), count, missed=number > count)
        table, first = self._numbered(0, max(number, 0), count)
        return Fresh(table, count, missed=first > number)

    def span(self, from_s: float, to_s: float, most: int) -> FloatArray:
        """Samples of a span of time out of the finest ring that has its beginning, at most so many.

        Thinned to extremes of pv, so that nothing that stood out is lost. Shape (n, FIELDS).
        """
        counts = self.counts()
        finer = np.empty((0, len(FIELDS)))
        for ring in range(RINGS):
            if ring and not counts[ring]:
                break
            table, first = self._numbered(ring, 0, counts[ring])
            newer = finer[finer[:, 0] > table[-1, 0]] if len(table) else finer
            table = np.concatenate((table, newer))  # the newest have not come as far as this ring
            finer = table
            within = int(np.count_nonzero((table[:, 0] >= from_s) & (table[:, 0] <= to_s)))
            if (first == 0 or (len(table) and table[0, 0] <= from_s)) and within <= BLOCK * most:
                break
        return thinned(finer[(finer[:, 0] >= from_s) & (finer[:, 0] <= to_s)], most)

    def extent(self) -> tuple[float, float]:
        """Times of the oldest and of the newest sample of which anything is kept, s; zeros before the first."""
        counts = self.counts()
        if not counts[0]:
            return 0.0, 0.0
        coarsest = max(ring for ring in range(RINGS) if counts[ring])
        oldest, _ = self._numbered(coarsest, 0, counts[coarsest])
        newest, _ = self._numbered(0, counts[0] - 1, counts[0])
        first, _ = self._numbered(0, 0, min(counts[0], 1)) if counts[0] < RING else (oldest, 0)
        return float(first[0, 0]), float(newest[-1, 0])

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def _numbered(self, ring: int, number: int, count: int) -> tuple[FloatArray, int]:
        """The samples from a number up to a count, and the number of the first of them that is whole."""
        first = max(number, count - RING + 1, 0)
        raw = b""
        at = first
        while at < count:
            most = min(count - at, RING - at % RING)
            part = os.pread(self._file, most * SAMPLE.size, place(ring, at))
            if len(part) < most * SAMPLE.size:
                break
            raw += part
            at += most
        table = np.frombuffer(raw, dtype="<f8").reshape(-1, len(FIELDS))
        overwritten = max(self.counts()[ring] - RING + 1 - first, 0)
        return table[overwritten:], first + overwritten

    def _document(self, at: int) -> dict[str, Any] | None:
        for _ in range(TRIES):
            raw = os.pread(self._file, SLOT - HEAD, at)
            if len(raw) < DOCUMENT.size:
                return None
            length, check = DOCUMENT.unpack_from(raw)
            body = raw[DOCUMENT.size : DOCUMENT.size + length]
            if length and len(body) == length and zlib.crc32(body) == check:
                document: dict[str, Any] = json.loads(body)
                return document
        return None


def thinned(table: FloatArray, most: int) -> FloatArray:
    """The first row, the last, and of each stretch those of the least and greatest pv: at most so many (4 or more)."""
    if len(table) <= most:
        return table
    stretches = np.array_split(np.arange(len(table)), max(most // 2 - 1, 1))
    pv = table[:, 2]
    kept = {int(part[pick(pv[part])]) for part in stretches for pick in (np.argmin, np.argmax)}
    return table[sorted(kept | {0, len(table) - 1})]
