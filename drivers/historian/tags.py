"""What a column is by its name: names of signals as control systems write them, and the loops they belong to.

FIC101.PV, FIC101/SP and FIC101_OP are three signals of the loop FIC101. Vendors differ in one word: MV is the
manipulated variable (the output) beside PV and SV, and the measured value beside OP; the other names decide.
"""

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType

from retuner.schedule.late_dataclass import dataclass

WORDS = MappingProxyType(
    {
        "t": "t ts time times timestamp timestamps datetime stamp zeit zeitstempel sampletime uhrzeit tagnames",
        "date": "date datum",
        "pv": "pv processvalue processvariable measurement measured meas istwert ist actual pvalue",
        "sp": "sp sv setpoint internalsetpoint setpt setp spt wsp sollwert soll target reference setvalue",
        "co": "co op out output controlleroutput outputvalue stellwert stellgrad stellgröße stellgroesse valveposition "
        "opout cvout",
        "mode": "mode auto aut modus controlmode opmode",
        "quality": "quality qual status validity qualitaet confidence",
        "tag": "tag tagname point pointname signal sensor name itemid",
        "value": "value wert val",
    }
)
"""Names of each role, written together in small letters. K-Spice calls its time "Tag-names"."""
ROLE_OF = MappingProxyType({word: role for role, words in WORDS.items() for word in words.split()})
SEPARATED = re.compile(r"[\s._/\\|:\-()\[\]]+")
SEPARATORS = " ._/\\|:-()[]"  # What may stand between a tag and its role
UNIT = re.compile(r"[\[(]([^\[()\]]*)[\])]\s*$")
TIME_UNIT = MappingProxyType(
    {
        "ns": "ns", "us": "us", "ms": "ms", "msec": "ms", "s": "s", "sec": "s", "second": "s", "seconds": "s",
        "min": "min", "minute": "min", "minutes": "min", "h": "h", "hr": "h", "hour": "h", "hours": "h", "d": "d",
        "day": "d", "days": "d",
    }
)  # fmt: skip
"""Units of time as column names write them."""


@dataclass(frozen=True, slots=True)
class NamedColumn:
    """A column by its name: which loop, which role ("" for none), and the unit that the name holds."""

    tag: str
    role: str
    unit: str


@lru_cache(maxsize=1 << 16)
def named(name: str) -> NamedColumn:
    """Read a column's name; a plant's names are asked for again and again."""
    unit = UNIT.search(name)
    bare = UNIT.sub("", name).strip() if unit and UNIT.sub("", name).strip() else name.strip()
    inside = unit.group(1).strip().lower() if unit else ""
    parts = [part for part in SEPARATED.split(bare) if part]
    for taken in range(min(3, len(parts)), 0, -1):
        word = "".join(parts[-taken:]).lower()
        role = "mv" if word == "mv" else ROLE_OF.get(word, "")
        if role:
            at = 0  # what stands before the words of the role is the loop
            for part in parts[:-taken]:
                at = bare.index(part, at) + len(part)
            return NamedColumn(bare[:at], role, inside)
    if len(parts) == 2 and parts[1].lower() in TIME_UNIT and ROLE_OF.get(parts[0].lower()) == "t":
        return NamedColumn("", "t", parts[1].lower())
    return NamedColumn("", "", inside)


def last_word(name: str) -> str:
    """The last word of a column's name without its unit, in small letters."""
    parts = [part for part in SEPARATED.split(UNIT.sub("", name)) if part]
    return parts[-1].lower() if parts else ""


def loops(names: Sequence[str]) -> dict[str, dict[str, list[int]]]:
    """Columns by loop and role; the loop "" holds what has no tag. MV is decided here, see the head of this file."""
    found: dict[str, dict[str, list[int]]] = {}
    for place, name in enumerate(names):
        read = named(name)
        if read.role:
            found.setdefault(read.tag, {}).setdefault(read.role, []).append(place)
    for roles in found.values():
        if "mv" in roles:
            free = [role for role in ("co", "pv") if role not in roles]
            role = "co" if "pv" in roles else free[-1] if len(free) == 1 else "mv"
            roles[role] = [*roles.get(role, []), *roles.pop("mv")]
    return found


def known_roles(names: Sequence[str]) -> int:
    """How many of the names say what they are: which row of several is the header."""
    return sum(bool(named(name).role) for name in names)


def complete(roles: Mapping[str, Sequence[int]]) -> bool:
    """Whether a loop has what a record needs: pv and co."""
    return "pv" in roles and "co" in roles
