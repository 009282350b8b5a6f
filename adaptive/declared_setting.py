"""How a setting is declared: once, at the field of the dataclass that uses it.

    class Settings:
        level: float = setting(3.0, "Standard deviations from which a response is worse", "2..6")
        hold_s: float = setting(60.0, "How long it stays", ">0..1e8 s", "a minute")

The declaration is what a reader sees, what the dataclass checks itself against, and what the configuration file's
section and its reference page are made of: a setting with a source stands in the file.
"""

import math
from dataclasses import field, fields
from functools import cache
from typing import Any, NamedTuple, TypeVar, get_type_hints

T = TypeVar("T")


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


class SettingLimits(NamedTuple):
    """What a setting may be. above, below : the end itself is too little, or too much. unit : empty for none."""

    low: float
    high: float
    above: bool
    below: bool
    unit: str

    @classmethod
    def of(cls, text: str) -> "SettingLimits":
        """Limits and unit as a data sheet has them: "0..1e9 s", ">0..1", "2.. samples", "%/pv"."""
        ends, _, unit = text.partition(" ") if ".." in text else ("..", "", text)
        low, _, high = ends.partition("..")
        least, most = low.removeprefix(">"), high.removeprefix("<")
        return cls(_number(least or "-inf"), _number(most or "inf"), least != low, most != high, unit)


def _number(text: str) -> float:
    return int(text) if text.removeprefix("-").isdigit() else float(text)


def setting(default: T, meaning: str, limits: str = "", source: str = "", *, absent: bool = False) -> T:
    """A field of a dataclass with its default and its declaration: see Setting. limits : for SettingLimits.of."""
    low, high, positive, _, unit = SettingLimits.of(limits)
    note = Setting(meaning, low, high, unit or "1", source, absent, positive)
    return field(default=default, metadata={Setting.__name__: note})


@cache
def declared(settings: type) -> tuple[Declared, ...]:
    """The declared fields of a dataclass, in their order."""
    kinds = get_type_hints(settings)
    return tuple(
        Declared(one.name, kinds[one.name], one.default, one.metadata[Setting.__name__])
        for one in fields(settings)
        if Setting.__name__ in one.metadata
    )


def require_in_range(settings: object, of: str) -> None:
    """Check every declared field of a dataclass's instance.

    Raises ValueError: a value is outside its range, or no number; of : whose settings these are.
    """
    kind: Any = type(settings)
    for name, _, _, (_, low, high, *_, positive) in declared(kind):
        value = getattr(settings, name)
        if value is not None and (not low <= value <= high or (positive and value == low)):
            raise ValueError(f"{of}: {name} = {value} is outside {low:g} to {high:g}")
