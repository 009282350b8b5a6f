"""Gain table to TOML text and back: what a person reads, diffs and keeps under version control.

The text is versioned (`schema`), lists the regions in their order, names the form of every set (always parallel) and
adds the ideal form as a comment, which is not read. Floats are written as repr does: the round trip is exact. One axis
without a filter is written as [schedule]. What needs more is written with an [[axis]] for each of one or two, and with
two in each [[region]] its cell, counted from 1 along each axis; the sets may then stand in any order. Reading is
strict: what is unknown, missing or out of range is refused with one line that says where. No file is touched here.

One section of a TOML text, read strictly: every value by key and kind, every error one line that says where.

Lines are found by looking for headers and for keys at the start of a line, which is how people and to_toml write them;
a key written otherwise (inline table, inside a string of several lines) is named without its line.
"""

import re
import sys
import tomllib
from collections import Counter

from retuner.schedule.gains import Form, PidGains, to_ideal
from retuner.schedule.regions import CAN, Axis, Regions
from retuner.schedule.table import GainTable, Lookup

# ---- One section of a TOML text, read strictly

HEADER = re.compile(r"\s*(\[\[?)\s*([A-Za-z0-9_-]+)\s*\]")
KEY = re.compile(r"\s*([A-Za-z0-9_-]+)\s*=")
SHOWN = 40  # How many characters of a refused value a message shows

Lines = dict[tuple[str, str], int]  # Line, counted from 1, of a key in a section; the key "" is the section's header


class TomlSection:
    """Values of a section. name : "" for the top of the document. lines : where its keys stand.

    Every method that reads raises ValueError when the key is missing or its value is of another kind.
    """

    def __init__(self, values: dict[str, object], name: str, lines: Lines) -> None:
        self._values = values
        self._name = name
        self._lines = lines

    def error(self, message: str, key: str = "") -> ValueError:
        """An error that says where: the line of the key, else that of the section, else the section alone."""
        line = self._lines.get((self._name, key)) or self._lines.get((self._name, ""))
        place = ", ".join(part for part in (f"line {line}" if line else "", self._name) if part)
        return ValueError(f"{place}: {message}" if place else message)

    def has(self, key: str) -> bool:
        """Whether the key is there."""
        return key in self._values

    def only(self, *known: str) -> None:
        """Refuse keys that nobody would read."""
        for key in self._values:
            if key not in known:
                raise self.error(f"{_short(key)} is unknown here; known are {', '.join(known)}", key)

    def text(self, key: str) -> str:
        """A string."""
        value = self._value(key)
        if not isinstance(value, str):
            raise self._kind(key, "a text in quotes")
        return value

    def whole(self, key: str) -> int:
        """An integer; a truth value is none."""
        value = self._value(key)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self._kind(key, "a whole number")
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        return self._finite(key, self._value(key))

    def numbers(self, key: str) -> tuple[float, ...]:
        """A list of finite numbers, maybe empty."""
        value = self._value(key)
        if not isinstance(value, list):
            raise self._kind(key, "a list of numbers")
        return tuple(self._finite(key, item) for item in value)

    def section(self, key: str) -> "TomlSection":
        """The section [key]."""
        value = self._value(key)
        if not isinstance(value, dict):
            raise self._kind(key, f"a section [{key}]")
        return TomlSection(value, key, self._lines)

    def sections(self, key: str) -> list["TomlSection"]:
        """The sections [[key]], at least one."""
        value = self._value(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self._kind(key, f"one or more sections [[{key}]]")
        return [TomlSection(item, f"{key} {i}", self._lines) for i, item in enumerate(value)]

    def _value(self, key: str) -> object:
        if key not in self._values:
            raise self.error(f"{key} is missing")
        return self._values[key]

    def _finite(self, key: str, value: object) -> float:
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self._kind(key, "a number")
        if not -sys.float_info.max <= value <= sys.float_info.max:
            raise self.error(f"{key} = {_short(value)} is not a finite number", key)
        return float(value)

    def _kind(self, key: str, wanted: str) -> ValueError:
        return self.error(f"{key} = {_short(self._values[key])} must be {wanted}", key)


def _short(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        return "a very long number"
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."


SCHEMA = 1  # version of this document. Older ones will be read, newer ones are refused.
MOST_AXES = 2

PERCENT = "in percent of the output range"  # the unit of co in every configuration
HEAD = """\
# Gain table of retuner. Gains are in parallel form, co {co}, times in seconds.
#   co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv)/dt
# The comment below each set is the same controller in ideal form; it is not read.
"""


def to_toml(table: GainTable, co: str = PERCENT) -> str:
    """The document of a table: UTF-8 text that ends with a line end; `from_toml` gives the same table back.

    co : the unit of co in its gains, for people: no key tells it.
    """
    regions = table.regions
    simple = len(regions.axes) == 1 and regions.axes[0].is_plain
    lines = [
        f"schema = {SCHEMA}",
        f"loop = {_quoted(table.loop)}",
        f"revision = {table.revision}",
        f"lookup = {_quoted(table.lookup)}  # {' or '.join(Lookup)}",
    ]
    for axis in regions.axes:
        lines += [
            "",
            "[schedule]" if simple else "[[axis]]",
            f"variable = {_quoted(axis.variable)}",
            *([f"signal = {_quoted(axis.signal)}"] if axis.variable == CAN else []),
            f"unit = {_quoted(axis.unit)}",
            f"low = {_number(axis.low)}",
            f"bounds = [{', '.join(map(_number, axis.bounds))}]",
            f"high = {_number(axis.high)}",
            f"hysteresis = {_number(axis.hysteresis)}  # each way, in unit",
            f"min_stay_s = {_number(axis.min_stay_s)}",
            *([] if simple else [f"filter_s = {_number(axis.filter_s)}"]),
        ]
    for i, gains in enumerate(table.gains):
        lines += ["", f"[[region]]  # {regions.text(i)}", f"name = {_quoted(regions.names[i])}"]
        if len(regions.axes) > 1:
            lines.append(f"cell = [{', '.join(str(place + 1) for place in regions.cell(i))}]")
        lines += [f"{key} = {_number(getattr(gains, key))}" for key in ("kp", "ki", "kd")]
        # the form is last, because it must be there: a file cut within a number is refused
        lines.append(f"form = {_quoted(Form.PARALLEL)}")
        try:
            ideal = to_ideal(gains)
        except ValueError:
            lines.append("# no ideal form")
        else:
            tau_i = "no integral action" if ideal.tau_i_s is None else f"tau_i = {ideal.tau_i_s:.4g} s"
            lines.append(f"# ideal form: kc = {ideal.kc:.4g}, {tau_i}, tau_d = {ideal.tau_d_s:.4g} s")
    return HEAD.format(co=co) + "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """A float that reads back as itself."""
    return repr(float(value))


def _quoted(text: str) -> str:
    """A TOML string; names are printable, so that only these two characters need a backslash."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def from_toml(text: str) -> GainTable:
    """The table of a document.

    Raises ValueError: the text is not TOML, its schema is not known, a key is missing, unknown or of a wrong kind, or a
    value is refused by Regions, PidGains or GainTable: one line, with the line of the text where it is known.
    """
    try:
        values: dict[str, object] = tomllib.loads(text)
    except RecursionError:
        raise ValueError("not TOML that can be read: brackets are nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"not TOML: {error}") from None
    # Where sections and keys stand; the i-th [[name]] is called "name i", from 0
    lines: Lines = {}
    section = ""
    entries: Counter[str] = Counter()
    for number, line in enumerate(text.split("\n"), start=1):
        if header := HEADER.match(line):
            section = header[2]
            if header[1] == "[[":
                entries[section] += 1
                section = f"{section} {entries[section] - 1}"
            lines.setdefault((section, ""), number)
        elif key := KEY.match(line):
            lines.setdefault((section, key[1]), number)
    top = TomlSection(values, "", lines)
    schema = top.whole("schema")
    if schema != SCHEMA:
        raise top.error(f"schema = {schema} is unknown; this version reads schema = {SCHEMA}", "schema")
    with_axes = top.has("axis")
    top.only("schema", "loop", "revision", "lookup", "axis" if with_axes else "schedule", "region")
    sets = top.sections("region")
    axes = [_axis(entry, simple=False) for entry in top.sections("axis")] if with_axes else []
    if len(axes) > MOST_AXES:
        raise top.error(f"{len(axes)} sections [[axis]]; a table has one or {MOST_AXES}")
    if len(axes) == MOST_AXES:
        found: dict[tuple[float, ...], TomlSection] = {}
        for entry in sets:
            cell = entry.numbers("cell")
            if len(cell) != len(axes) or not all(
                i == int(i) and 1 <= i <= len(axis) for i, axis in zip(cell, axes, strict=False)
            ):
                most = ", ".join(str(len(axis)) for axis in axes)
                raise entry.error(
                    f"cell = {_shown(cell)} must be a place on each axis, counted from 1 to {most}", "cell"
                )
            if cell in found:
                raise entry.error(f"cell = {_shown(cell)} is given twice", "cell")
            found[cell] = entry
        cells = [(float(i), float(j)) for i in range(1, len(axes[0]) + 1) for j in range(1, len(axes[1]) + 1)]
        missing = [cell for cell in cells if cell not in found]
        if missing:
            raise top.error(f"no [[region]] with cell = {_shown(missing[0])}; each cell needs one")
        sets = [found[cell] for cell in cells]
    gains = tuple(_gains(entry, with_cell=len(axes) == MOST_AXES) for entry in sets)
    names = tuple(entry.text("name") for entry in sets)
    regions = Regions.along(names, *axes) if with_axes else _regions(top.section("schedule"), names)
    loop, lookup, revision = top.text("loop"), top.text("lookup"), top.whole("revision")
    if lookup not in tuple(Lookup):
        raise top.error(f"lookup = {lookup!r} is unknown; use {' or '.join(Lookup)}", "lookup")
    return GainTable(loop, regions, gains, Lookup(lookup), revision)


def _regions(schedule: TomlSection, names: tuple[str, ...]) -> Regions:
    axis = _axis(schedule, simple=True, names=names)
    try:
        return Regions.along(names, axis)
    except ValueError as error:
        raise schedule.error(str(error)) from None


def _axis(section: TomlSection, *, simple: bool, names: tuple[str, ...] = ()) -> Axis:
    known = ["variable", "unit", "low", "bounds", "high", "hysteresis", "min_stay_s"]
    variable, unit = section.text("variable"), section.text("unit")
    of_can = [] if simple or variable != CAN else ["signal"]
    section.only(*known, *of_can, *([] if simple else ["filter_s"]))
    bounds = section.numbers("bounds")
    low, high, hysteresis, min_stay_s = map(section.number, ("low", "high", "hysteresis", "min_stay_s"))
    filter_s = 0.0 if simple else section.number("filter_s")
    signal = section.text("signal") if of_can else ""
    try:
        return Axis(variable, unit, low, bounds, high, hysteresis, min_stay_s, filter_s, signal, names)
    except ValueError as error:
        raise section.error(str(error)) from None


def _shown(cell: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{i:g}' for i in cell)}]"


def _gains(entry: TomlSection, *, with_cell: bool) -> PidGains:
    entry.only("name", "form", "kp", "ki", "kd", *(["cell"] if with_cell else []))
    form = entry.text("form")
    if form != Form.PARALLEL:
        raise entry.error(f"form = {form!r}: a gain table holds {str(Form.PARALLEL)!r} gains kp, ki, kd", "form")
    kp, ki, kd = map(entry.number, ("kp", "ki", "kd"))
    try:
        return PidGains(kp, ki, kd)
    except ValueError as error:
        raise entry.error(str(error)) from None
