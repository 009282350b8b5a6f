"""No signal or object of a device may be two things: a setpoint written where a gain lies would become that gain."""

from collections.abc import Iterable
from itertools import combinations
from typing import NamedTuple

from retuner.drivers.profiles.controller_access import ProfileError


class Use(NamedTuple):
    """Where one thing of a mapping lies.

    role, what, key : see mapping.Named. frame : identifier of the message, or index and sub-index of the object.
    pages : values of the multiplexer under which it is there; empty: always. bits : of the message. text : the signal
    or object, for people.
    """

    role: str
    what: str
    frame: tuple[int, int]
    pages: frozenset[int]
    bits: frozenset[int]
    text: str
    key: tuple[str | int, ...]

    def meets(self, other: "Use") -> bool:
        """Whether both lie in the same bits of the same frame."""
        together = not self.pages or not other.pages or bool(self.pages & other.pages)
        return self.frame == other.frame and together and bool(self.bits & other.bits)


def require_distinct(uses: Iterable[Use], source: str) -> None:
    """Refuse a mapping in which one signal or object is two things.

    Raises ProfileError: the later of the two is named by its key.
    """
    for one, other in combinations(uses, 2):
        if one.what == other.what or not one.meets(other):
            continue
        same = f"{one.text} is both" if one.text == other.text else f"{one.text} and {other.text} share bits; they are"
        raise ProfileError(f"{source}: {same} {one.role} and {other.role}; give each a place of its own", other.key)
