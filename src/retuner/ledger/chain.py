"""The hash chain: each row's hash covers its content and the hash of the row before it.

    hash = sha256(canonical JSON of [previous hash, seq, clock_s, kind, body text])

So a changed, removed, inserted or reordered row breaks every hash after it. Rows cut off at the end break nothing that
is left; that is why the store keeps the head beside the rows. Whoever can write the file can set that back too, or
recompute every hash: the hashes are no signature. So a run tells its head (screen, summary.json, report), and a check
may be given one that was noted elsewhere.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from retuner.schedule.late_dataclass import dataclass

# ---- One value, one text: the JSON that is hashed and stored


def canonical_json(value: object) -> str:
    """The canonical text of a value made of mappings with text keys, sequences, text, numbers, true, false and None.

    Raises ValueError: a number is not finite, a key is no text, or a value is of another kind; the message has its
    path.
    """
    _check(value, "body")
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _check(value: object, where: str) -> None:
    is_whole_or_none = isinstance(value, int | None)
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise ValueError(f"{where} has a key that is no text")
        for key, inner in value.items():
            _check_text(key, where)
            _check(inner, f"{where}.{key}")
    elif isinstance(value, str):
        _check_text(value, where)
    elif isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        for i, inner in enumerate(value):
            _check(inner, f"{where}[{i}]")
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{where} = {value} is not a finite number; a ledger holds finite numbers only")
    elif not is_whole_or_none:
        raise ValueError(f"{where} is a {type(value).__name__}; a ledger holds text, numbers, true, false and null")


def _check_text(text: str, where: str) -> None:
    """Text that UTF-8 can hold (a lone half of a surrogate pair is none)."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError(f"{where} has text that is not Unicode: {text!a}") from None


def _plain(value: object) -> object:
    """The value with plain dicts and lists, which is all that json takes."""
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(inner) for inner in value]
    return value


GENESIS = "0" * 64  # stands for the row before the first


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a ledger.

    seq : from 1. clock_s : time of the run's clock, seconds. kind : what the row is. text : its body, canonical JSON.
    previous, hash : of the row before and of this one, hexadecimal.
    """

    seq: int
    clock_s: float
    kind: str
    text: str
    previous: str
    hash: str

    @property
    def body(self) -> dict[str, Any]:
        """The body as it was given, with plain dicts and lists."""
        body: dict[str, Any] = json.loads(self.text)
        return body


@dataclass(frozen=True, slots=True)
class ChainReport:
    """Whether a ledger can be believed.

    rows : number of rows. head : hash of the last row (of the last good one when broken). broken_seq : first row that
    cannot be believed, None when all can. reason : what is wrong with it, empty when all is well.
    """

    rows: int
    head: str
    broken_seq: int | None = None
    reason: str = ""

    @property
    def ok(self) -> bool:
        """Whether every row can be believed."""
        return self.broken_seq is None


def next_row(previous: str, seq: int, clock_s: float, kind: str, text: str) -> Row:
    """The row that follows the one with hash `previous`. text : the body as canonical JSON.

    Raises ValueError: clock_s is not finite.
    """
    covered = canonical_json([previous, seq, float(clock_s), kind, text])
    return Row(seq, float(clock_s), kind, text, previous, hashlib.sha256(covered.encode("utf-8")).hexdigest())


def check_chain(rows: Iterable[Row], head: tuple[int, str], anchor: str = "") -> ChainReport:
    """Recompute every hash. head : (seq, hash) that the last row must have, as remembered beside the rows; anchor : the
    beginning of the hash of a row that must be there.
    """
    last, count = GENESIS, 0
    found = GENESIS.startswith(anchor)
    for row in rows:
        seq = count + 1
        if row.seq != seq:
            reason = f"row {seq} is missing; row {row.seq} stands in its place"
        elif row.previous != last:
            reason = f"row {seq} does not follow the row before it"
        else:
            try:
                expected = next_row(last, row.seq, row.clock_s, row.kind, row.text).hash
            except ValueError:  # not even a row's kind of values
                expected = ""
            reason = "" if expected == row.hash else f"row {seq} was changed after it was written"
        if reason:
            return ChainReport(count, last, count + 1, reason)
        last, count = row.hash, count + 1
        found = found or last.startswith(anchor)
    if (count, last) != head:
        reason = (
            f"the ledger ended with row {head[0]}, hash {head[1][:12]}; rows were cut off or replaced after {count}"
        )
        return ChainReport(count, last, count + 1, reason)
    if not found:
        reason = f"no row has the hash {anchor[:12]}; rows were cut off after {count}, or this is another ledger"
        return ChainReport(count, last, count + 1, reason)
    return ChainReport(count, last)


# ---- A decision as its row keeps it, and the hash by which other rows name it

PLACE = "samples"  # key that a session adds to the body of each row: the number of samples that had been seen


def without_place(body: Mapping[str, Any]) -> dict[str, Any]:
    """The body of a row as it was given, without its place in the order of samples."""
    return {key: value for key, value in body.items() if key != PLACE}


def canonical(decision: Mapping[str, Any]) -> bytes:
    """A decision's plain values as Decision.canonical() has them."""
    return json.dumps(decision, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest_of(decision: Mapping[str, Any]) -> str:
    """Hash of a decision's plain values, as Decision.digest() has it."""
    return hashlib.sha256(canonical(decision)).hexdigest()
