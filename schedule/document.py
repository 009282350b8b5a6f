"""Gain table to TOML text and back: what a person reads, diffs and keeps under version control.

The text is versioned (`schema`), lists the regions from low to high, names the form of every set (always parallel) and
adds the ideal form as a comment, which is not read. Floats are written as repr does: the round trip is exact.
Reading is strict: what is unknown, missing or out of range is refused with one line that says where. No file is
touched here.
"""

from collections.abc import Iterator

from retuner.schedule.forms import Form, to_ideal
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup
from retuner.schedule.toml_section import Section, read_toml

SCHEMA = 1
"""Version of this document. Older ones will be read, newer ones are refused."""

HEAD = """\
# Gain table of retuner. Gains are in parallel form, co in percent of the output range, times in seconds:
#   co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv)/dt
# The comment below each set is the same controller in ideal form; it is not read.
"""


def to_toml(table: GainTable) -> str:
    """The document of a table: UTF-8 text that ends with a line end; `from_toml` gives the same table back."""
    regions = table.regions
    lines = [
        f"schema = {SCHEMA}",
        f"loop = {_quoted(table.loop)}",
        f"revision = {table.revision}",
        f"lookup = {_quoted(table.lookup)}  # {' or '.join(Lookup)}",
        "",
        "[schedule]",
        f"variable = {_quoted(regions.variable)}",
        f"unit = {_quoted(regions.unit)}",
        f"low = {_number(regions.low)}",
        f"bounds = [{', '.join(_number(bound) for bound in regions.bounds)}]",
        f"high = {_number(regions.high)}",
        f"hysteresis = {_number(regions.hysteresis)}  # each way, in unit",
        f"min_stay_s = {_number(regions.min_stay_s)}",
    ]
    for i, gains in enumerate(table.gains):
        lines += ["", *_region_lines(regions, i, gains)]
    return HEAD + "\n".join(lines) + "\n"


def _region_lines(regions: Regions, i: int, gains: PidGains) -> Iterator[str]:
    """One set of gains."""
    low, high = regions.span(i)
    yield f"[[region]]  # {low:g} to {high:g} {regions.unit}".rstrip()
    yield f"name = {_quoted(regions.names[i])}"
    for key in ("kp", "ki", "kd"):
        yield f"{key} = {_number(getattr(gains, key))}"
    yield f"form = {_quoted(Form.PARALLEL)}"  # last, because it must be there: a file cut within a number is refused
    yield f"# {_for_people(gains)}"


def _for_people(gains: PidGains) -> str:
    """The ideal form in words."""
    try:
        ideal = to_ideal(gains)
    except ValueError:
        return "no ideal form"
    tau_i = "no integral action" if ideal.tau_i_s is None else f"tau_i = {ideal.tau_i_s:.4g} s"
    return f"ideal form: kc = {ideal.kc:.4g}, {tau_i}, tau_d = {ideal.tau_d_s:.4g} s"


def _number(value: float) -> str:
    """A float that reads back as itself."""
    return repr(float(value))


def _quoted(text: str) -> str:
    """A TOML string; names are printable, so that only these two characters need a backslash."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def from_toml(text: str) -> GainTable:
    """The table of a document.

    Raises
    ------
    ValueError
        The text is not TOML, its schema is not known, a key is missing, unknown or of a wrong kind, or a value is
        refused by Regions, PidGains or GainTable: one line, with the line of the text where it is known.
    """
    top = read_toml(text)
    schema = top.whole("schema")
    if schema != SCHEMA:
        raise top.error(f"schema = {schema} is unknown; this version reads schema = {SCHEMA}", "schema")
    top.only("schema", "loop", "revision", "lookup", "schedule", "region")
    sets = top.sections("region")
    gains = tuple(_gains(entry) for entry in sets)
    regions = _regions(top.section("schedule"), tuple(entry.text("name") for entry in sets))
    loop, lookup, revision = top.text("loop"), top.text("lookup"), top.whole("revision")
    if lookup not in tuple(Lookup):
        raise top.error(f"lookup = {lookup!r} is unknown; use {' or '.join(Lookup)}", "lookup")
    return GainTable(loop, regions, gains, Lookup(lookup), revision)


def _regions(schedule: Section, names: tuple[str, ...]) -> Regions:
    """The regions of section [schedule] with the names of the sets."""
    schedule.only("variable", "unit", "low", "bounds", "high", "hysteresis", "min_stay_s")
    variable, unit, bounds = schedule.text("variable"), schedule.text("unit"), schedule.numbers("bounds")
    low, high, hysteresis, min_stay_s = map(schedule.number, ("low", "high", "hysteresis", "min_stay_s"))
    try:
        return Regions(variable, unit, names, low, bounds, high, hysteresis, min_stay_s)
    except ValueError as error:
        raise schedule.error(str(error)) from None


def _gains(entry: Section) -> PidGains:
    """The gains of one [[region]]."""
    entry.only("name", "form", "kp", "ki", "kd")
    form = entry.text("form")
    if form != Form.PARALLEL:
        raise entry.error(f"form = {form!r}: a gain table holds {str(Form.PARALLEL)!r} gains kp, ki, kd", "form")
    kp, ki, kd = map(entry.number, ("kp", "ki", "kd"))
    try:
        return PidGains(kp, ki, kd)
    except ValueError as error:
        raise entry.error(str(error)) from None
