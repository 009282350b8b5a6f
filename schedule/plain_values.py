"""Objects as plain values: what JSON, the ledger and the state of a retuner hold."""

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from retuner.schedule.gains import PidGains


def plain_values(thing: object, names: str) -> dict[str, Any]:
    """Attributes of an object as plain values; names : as in "waves pu=pu_s" where a key differs from its attribute."""
    pairs = (name.partition("=") for name in names.split())
    return {key: plain_value(getattr(thing, attribute or key)) for key, _, attribute in pairs}


def plain_value(value: Any) -> Any:  # noqa: ANN401  anything that JSON knows, or that says itself what it is there
    """A value as JSON has it: None where a number is infinite or not known; gains by name."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, PidGains):
        return {"kp": value.kp, "ki": value.ki, "kd": value.kd}
    if isinstance(value, StrEnum):
        return str(value)
    if isinstance(value, tuple | list):
        return [plain_value(one) for one in value]
    if isinstance(value, Mapping):
        return {name: plain_value(one) for name, one in value.items()}
    return value.to_dict() if hasattr(value, "to_dict") else value
