"""What every format of an exported table needs: its numbers in order, and names that a compiler takes."""

import math
import re
from dataclasses import dataclass

from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup
from retuner.schedule.vendor_units import SINGLE_MAX


@dataclass(frozen=True, slots=True)
class AxisNumbers:
    """One axis: borders, how far each part may be left before it changes, centres, filter and minimum stay."""

    label: str
    unit: str
    bounds: tuple[float, ...]
    floors: tuple[float, ...]
    ceilings: tuple[float, ...]
    centres: tuple[float, ...]
    filter_s: float
    min_stay_s: float


@dataclass(frozen=True, slots=True)
class TableNumbers:
    """A table as a program holds it. plain : its only axis follows from the value alone."""

    name: str
    axes: tuple[AxisNumbers, ...]
    gains: tuple[tuple[float, float, float], ...]
    names: tuple[str, ...]
    interpolated: bool
    plain: bool
    revision: int


def numbers_of(table: GainTable) -> TableNumbers:
    """The numbers of a table."""
    regions = table.regions
    gains = tuple((g.kp, g.ki, g.kd) for g in table.gains)
    plain = len(regions.axes) == 1 and regions.axes[0].is_plain
    axes = tuple(_axis(regions, i) for i in range(len(regions.axes)))
    return TableNumbers(
        identifier(table.loop), axes, gains, regions.names, table.lookup is Lookup.INTERPOLATED, plain, table.revision
    )


def _axis(regions: Regions, i: int) -> AxisNumbers:
    axis = regions.axes[i]
    law = axis.law()
    centres = tuple(axis.centre(part) for part in range(len(axis)))
    return AxisNumbers(
        axis.label, axis.unit, law.bounds, law.floors, law.ceilings, centres, law.filter_s, law.min_stay_s
    )


def identifier(name: str) -> str:
    """A name as C and structured text take it: lower case, digits and underscores, a letter first."""
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "loop"
    return plain if plain[0].isalpha() else f"loop_{plain}"


def comment(text: str) -> str:
    """A name inside a comment of any format: nothing that could end it."""
    return re.sub(r"[^\w .,+%/-]", "?", text).replace("*/", "? ").replace("//", "/ ")


def finite(value: float) -> float:
    """A border, with the largest single number in place of infinity: no value that a controller has lies beyond it."""
    return math.copysign(SINGLE_MAX, value) if math.isinf(value) else value
