"""How a setting is declared: once, at the field of the dataclass that uses it.

    class Settings:
        level: Annotated[float, Setting("Standard deviations from which a response is worse", 2, 6)] = 3.0

The declaration is what a reader sees, what the dataclass checks itself against, and what the configuration file's
section and its reference page are made of: a setting with a source stands in the file.
"""

import math
from dataclasses import fields
from functools import cache
from typing import Any, NamedTuple, get_type_hints


class Setting(NamedTuple):
    """meaning : one sentence without a full stop. low, high : least and greatest value. unit : "1" for ratios.

    source : where the default comes from; empty: not in the configuration file. absent : the file may leave it out for
    no limit, or for another setting's value. positive : `low` itself is too little.
    """

    meaning: str
    low: float = -math.inf
    high: float = math.inf
    unit: str = "1"
    source: str = ""
    absent: bool = False
    positive: bool = False


class Declared(NamedTuple):
    """A field of a dataclass with its declaration."""

    name: str
    type: Any
    default: object
    setting: Setting


@cache
def declared(settings: type) -> tuple[Declared, ...]:
    """The declared fields of a dataclass, in their order."""
    plain, annotated = get_type_hints(settings), get_type_hints(settings, include_extras=True)
    return tuple(
        Declared(field.name, plain[field.name], field.default, note)
        for field in fields(settings)
        for note in getattr(annotated[field.name], "__metadata__", ())
        if isinstance(note, Setting)
    )


def require_in_range(settings: object, of: str) -> None:
    """Check every declared field of a dataclass's instance.

    Raises
    ------
    ValueError
        A value is outside its range, or no number; of : whose settings these are.
    """
    kind: Any = type(settings)
    for name, _, _, (_, low, high, *_, positive) in declared(kind):
        value = getattr(settings, name)
        if value is not None and (not low <= value <= high or (positive and value == low)):
            raise ValueError(f"{of}: {name} = {value} is outside {low:g} to {high:g}")
