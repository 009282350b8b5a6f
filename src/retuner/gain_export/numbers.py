"""What every format of an exported table needs: its numbers in order, and names that a compiler takes."""

import math
import re
from array import array
from collections.abc import Iterable

from retuner.schedule.controller_units import ControllerUnits
from retuner.schedule.gains import PidGains, in_form
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.table import GAIN_NAMES, GainTable, Lookup
from retuner.schedule.vendor_units import SINGLE_MAX
from retuner.templates import rendered


@dataclass(frozen=True, slots=True)
class AxisNumbers:
    """One axis: boundaries, how far each part may be left before it changes, centres, filter and minimum stay."""

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
    axes = tuple(
        AxisNumbers(
            label=axis.label,
            unit=axis.unit,
            bounds=law.bounds,
            floors=law.floors,
            ceilings=law.ceilings,
            centres=tuple(axis.centre(part) for part in range(len(axis))),
            filter_s=law.filter_s,
            min_stay_s=law.min_stay_s,
        )
        for axis, law in ((axis, axis.law()) for axis in regions.axes)
    )
    return TableNumbers(
        identifier(table.loop), axes, gains, regions.names, table.lookup is Lookup.INTERPOLATED, plain, table.revision
    )


def identifier(name: str) -> str:
    """A name as C and structured text take it: lower case, digits and underscores, a letter first."""
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "loop"
    return plain if plain[0].isalpha() else f"loop_{plain}"


def comment(text: str) -> str:
    """A name inside a comment of any format: nothing that could end it."""
    return re.sub(r"[^\w .,+%/-]", "?", text).replace("*/", "? ").replace("//", "/ ")


def finite(value: float) -> float:
    """A boundary, with the largest single number in place of infinity: no controller has a value beyond it."""
    return math.copysign(SINGLE_MAX, value) if math.isinf(value) else value


# ---- A gain table as CSV, for spreadsheets, and as a DBC whose signals start at the gains, for CAN tools

FIRST_ID = 0x100
MOST_REGIONS = 256


def csv_table(table: GainTable, units: ControllerUnits | None = None) -> str:
    """A line a region: its place on each axis, the parallel gains, and the ideal form where there is one.

    units : those of a controller, whose own numbers stand in place of the ideal form.

    Raises ValueError: that controller cannot hold a set.
    """
    axes = range(len(table.regions.axes))
    heads = [part for i in axes for part in (f"low{i + 1}", f"high{i + 1}", f"unit{i + 1}")]
    own = ["kc_ideal", "tau_i_s", "tau_d_s"]
    if units is not None:  # word and unit of a controller's own numbers
        dials = (dial for dial in units.dials if dial.label)
        own = [f"{dial.label} [{dial.unit.strip()}]" if dial.unit else dial.label for dial in dials]
    lines = [",".join(["region", *heads, *GAIN_NAMES, *own])]
    for r, (name, gains) in enumerate(zip(table.regions.names, table.gains, strict=True)):
        place: list[str] = []
        for i in axes:
            low, high = table.regions.span(r, i)
            place += [repr(low), repr(high), _cell(table.regions.axes[i].unit)]
        parallel = [repr(getattr(gains, gain)) for gain in GAIN_NAMES]
        lines.append(",".join([_cell(name), *place, *parallel, *_own(table.gains[r], units)]))
    return "\n".join(lines) + "\n"


def _own(gains: PidGains, units: ControllerUnits | None) -> list[str]:
    """A controller's own numbers, or the ideal form's; empty cells for what does not exist."""
    if units is not None:
        shown = units.numbers(gains)
        if shown.form != units.form:
            raise ValueError(f"these gains have no {units.form} form, which the controller needs")
        pairs = zip(units.dials, shown[:3], strict=True)
        return ["" if value is None else repr(value) for dial, value in pairs if dial.label]
    try:
        form = in_form(gains, "ideal")
    except ValueError:
        return ["", "", ""]
    return ["" if value is None else repr(value) for value in (form["kc"], form["tau_i"], form["tau_d"])]


def _cell(text: str) -> str:
    """A text as a cell: quoted where it must be, and never a formula."""
    safe = f"'{text}" if text[:1] in {"=", "+", "-", "@"} else text
    return '"' + safe.replace('"', '""') + '"' if any(c in safe for c in ',"\n\r') else safe


def dbc_table(table: GainTable) -> str:
    """A message a region with kp, ki and kd as float32 signals whose start values are the gains.

    Raises ValueError: there are more regions than identifiers.
    """
    if len(table.gains) > MOST_REGIONS:
        raise ValueError(f"{len(table.gains)} regions; a DBC is made for at most {MOST_REGIONS}")
    messages, comments, starts, types = [], [], [], []
    for i, (name, gains) in enumerate(zip(table.regions.names, table.gains, strict=True)):
        frame = FIRST_ID + i
        messages.append(f"BO_ {frame} GAINS_{i + 1}_{identifier(name).upper()[:20]}: 12 host")
        comments.append(f'CM_ BO_ {frame} "{comment(name)}: {comment(table.regions.text(i))}";')
        for k, gain in enumerate(GAIN_NAMES):
            messages.append(f' SG_ {gain} : {32 * k}|32@1- (1,0) [0|0] "" controller')
            # A gain as the wire carries it
            starts.append(f'BA_ "GenSigStartValue" SG_ {frame} {gain} {array("f", [getattr(gains, gain)])[0]!r};')
            types.append(f"SIG_VALTYPE_ {frame} {gain} : 1;")
        starts.append(f'BA_ "VFrameFormat" BO_ {frame} 14;')
        messages.append("")
    head = ['VERSION ""', "", "NS_ :", "", "BS_:", "", "BU_: host controller", ""]
    formats = ",".join(f'"{name}"' for name in FRAME_FORMATS)
    attributes = [
        'BA_DEF_ SG_ "GenSigStartValue" FLOAT -3.4e38 3.4e38;',
        f'BA_DEF_ BO_ "VFrameFormat" ENUM {formats};',
        'BA_DEF_DEF_ "GenSigStartValue" 0;',
        'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";',
    ]
    about = f'CM_ "Gains of {comment(table.loop)}, revision {table.revision}, exported by retuner; CAN FD frames.";'
    return "\n".join([*head, *messages, about, *comments, *attributes, *starts, *types]) + "\n"


FRAME_FORMATS = (
    "StandardCAN", "ExtendedCAN", "reserved", "J1939PG", "reserved", "reserved", "reserved", "reserved", "reserved",
    "reserved", "reserved", "reserved", "reserved", "reserved", "StandardCAN_FD", "ExtendedCAN_FD",
)  # fmt: skip
"""What Vector's attribute of a message's frame format may be, in its order."""


# A gain table as a program: one C99 header, without allocation or libraries, or an IEC 61131-3 function block.
#
# Their text stands in templates/gains.h.jinja and gains.st.jinja. Both do the same operations in the same order as
# schedule/regions.py and schedule/table.py, in double, and round the gains to float at the end: so firmware and host
# have the same gains, bit for bit in float32 (but compile C without contraction: -ffp-contract=off). Where a double is
# too dear, RETUNER_REAL may be float; then the last bits differ.


def c_header(table: TableNumbers, source: str) -> str:
    """The text of the header; source : where the table comes from, for people."""
    return rendered("gains.h.jinja", t=table, source=source, comment=comment, listed=_listed)


def structured_text(table: TableNumbers, source: str) -> str:
    """The text of the function block; source : where the table comes from, for people."""
    return rendered("gains.st.jinja", t=table, source=source, comment=comment, listed=_listed)


def _listed(values: Iterable[float]) -> str:
    return ", ".join(repr(float(finite(value))) for value in values)
