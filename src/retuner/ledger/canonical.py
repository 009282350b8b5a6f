"""One value, one text: the JSON that is hashed and stored.

Keys sorted, no spaces, UTF-8, the shortest decimal that gives the same double back. NaN and infinity are no JSON; what
they would mean later nobody could say, so they are refused with the path at which they stand.
"""

import json
import math
from collections.abc import Mapping, Sequence


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
