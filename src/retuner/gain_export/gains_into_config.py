"""Tuned gains back into the configuration that they began in: only the numbers change, every comment stays.

tomlkit keeps a document as it was written. Each region keeps its form; where the tuned set has none in it (a series
form needs tau_I of at least four tau_D), the form becomes ideal, and that is told. The numbers have as few digits as
give the controller the very set: the same float32, or the same numbers of a device of its own kind.
"""

from collections.abc import Callable, Mapping, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from retuner.adaptive.guard.step_size import change_factor
from retuner.config import Config
from retuner.config.described import vendor_units
from retuner.config.loading import UnusableError, load_session, parse_session
from retuner.drivers.protocol.checksum import to_wire
from retuner.errors import UserError
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable
from retuner.schedule.vendor_units import Quantity

SAME = 1.0 + 1e-9
"""Factor within which gains that went through a form and back are the same, where no controller can hold them."""
NO_INTEGRAL = "none"
DIGITS = range(1, 18)  # Significant digits that are tried; 17 tell every float64
Same = Callable[[PidGains, PidGains], bool]


def into_config(path: Path, table: GainTable) -> tuple[str, list[str]]:
    """The configuration's text with the table's gains, and a line on each region that changed.

    Raises UserError: the configuration cannot be read, its regions are not the table's, or a set has no form that it
    can be written in; nothing was changed.
    """
    session, text = load_session(path)
    if session.several and table.loop not in session.names:
        raise UserError(
            f"{path}: has the loops {', '.join(session.names)}, the table is of {table.loop!r}; "
            "gains go back only where they came from"
        )
    place = session.place(table.loop if session.several else None)
    config, several = session.loops[place], session.several
    same = sameness(config)
    names = [region.name for region in config.schedule.regions]
    if sorted(names) != sorted(table.regions.names):
        raise UserError(
            f"{path}: has the regions {', '.join(names)}, the table {', '.join(table.regions.names)}; "
            "gains go back only where they came from"
        )
    # Names may be alike where places are not
    own = config.gain_table()
    if own.lookup != table.lookup or [a.bounds for a in own.regions.axes] != [a.bounds for a in table.regions.axes]:
        raise UserError(
            f"{path}: its boundaries or its lookup are not the table's; gains go back only where they came from. "
            "Take up another schedule by its [schedule] section"
        )
    try:
        document = tomlkit.parse(text)
        holder: Mapping[str, Any] = document["loop"][place].get("schedule", {}) if several else document["schedule"]
        if several and "region" not in holder:
            where = "the regions stand at the top of the file for all loops"
            raise UserError(f"{where}; give the loop a [loop.schedule] first")
        regions = list[MutableMapping[str, Any]](holder["region"])
        told = [line for region in regions for line in _put(region, table, config, same)]
    except (TOMLKitError, KeyError, TypeError) as error:
        raise UserError(f"{path}: its regions cannot be found to be written: {error}") from None
    written = tomlkit.dumps(document)
    try:
        config = parse_session(written).loops[place]
    except UnusableError as unusable:
        flaw = unusable.findings[0]
        raise UserError(f"{path}: with the tuned gains it would be refused: {flaw.key} {flaw.message}") from None
    for region, gains in zip(config.schedule.regions, config.gains(), strict=True):
        if not same(gains, table.gains_of(region.name)):
            raise UserError(
                f"{path}: region {region.name} would not be read back as the tuned gains; nothing was changed"
            )
    return written, told


def sameness(config: Config) -> Same:
    """Whether two sets are one set on the configured controller."""
    units = vendor_units(config)
    held = to_wire if units is None else units.rounded

    def same(one: PidGains, other: PidGains) -> bool:
        try:
            return held(one) == held(other)
        except ValueError:
            return change_factor(one, other) <= SAME

    return same


def _put(region: MutableMapping[str, Any], table: GainTable, config: Config, same: Same) -> list[str]:
    name = str(region["name"])
    units = config.units_in(next(one for one in config.schedule.regions if one.name == name))
    # The set in the region's units, or in the ideal form, in the fewest digits that make it again
    gains = table.gains_of(name)
    if gains.kp == 0:
        raise UserError("a region has no proportional gain, which [[schedule.region]] cannot say")
    exact = units.numbers(gains)
    own, shown = units.of_region(units.dials, exact.form), exact
    for digits in DIGITS:
        gain, derivative = (float(f"{number:.{digits}g}") for number in (exact.gain, exact.derivative))
        integral = None if exact.integral is None else float(f"{exact.integral:.{digits}g}")
        try:
            if same(own.gains(gain, integral, derivative), gains):
                shown = exact._replace(gain=gain, integral=integral, derivative=derivative)
                break
        except ValueError:  # a rounded number may leave the form
            continue
    before = [region.get(dial.key) for dial in units.dials]
    none = NO_INTEGRAL if units.dials[1].quantity is Quantity.TN else 0.0
    values = (shown.gain, none if shown.integral is None else shown.integral, shown.derivative)
    for dial, value in zip(units.dials, values, strict=True):
        if value or dial.key in region:
            _set(region, dial.key, value)
    if shown.form != units.form:
        _set(region, "form", str(shown.form))
    after = [region.get(dial.key) for dial in units.dials]
    if list(map(str, before)) == list(map(str, after)):
        return []
    one, two = (
        " ".join(
            f"{dial.key} {value}" if isinstance(value, str) else f"{dial.key} {value or 0.0:.4g}"
            for dial, value in zip(units.dials, values, strict=True)
        )
        for values in (before, after)
    )
    return [f"{name}: {one} -> {two} ({region.get('form', 'series')})"]


def _set(region: MutableMapping[str, Any], key: str, value: object) -> None:
    """Change a value and leave what stands behind it on its line."""
    item = tomlkit.item(value)
    trivia = getattr(region.get(key), "trivia", None)
    if trivia is not None:
        item.trivia.comment_ws, item.trivia.comment = trivia.comment_ws, trivia.comment
        item.trivia.trail = trivia.trail
    region[key] = item
