"""A decision as its row keeps it, and the hash by which other rows name it."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

PLACE = "samples"
"""Key that a session adds to the body of each row: the number of samples that had been seen."""


def without_place(body: Mapping[str, Any]) -> dict[str, Any]:
    """The body of a row as it was given, without its place in the order of samples."""
    return {key: value for key, value in body.items() if key != PLACE}


def canonical(decision: Mapping[str, Any]) -> bytes:
    """A decision's plain values as Decision.canonical() has them."""
    return json.dumps(decision, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest_of(decision: Mapping[str, Any]) -> str:
    """Hash of a decision's plain values, as Decision.digest() has it."""
    return hashlib.sha256(canonical(decision)).hexdigest()
