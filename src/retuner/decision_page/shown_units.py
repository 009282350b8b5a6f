"""In which units gains are shown: those of the loop's own controller, as its configuration says ([loop] controller).

A command that has read a configuration says so once; everything that is shown afterwards follows, each loop in its own
units. Where a text does not say which loop it is about, the units are those that all loops share.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

from retuner.schedule.controller_units import ControllerUnits

if TYPE_CHECKING:  # slow to load, and records have no configuration
    from retuner.config.session_config import SessionConfig

DEFAULT = ControllerUnits()  # gain in co units per pv unit, times in seconds, series form where it exists
_units: dict[str, ControllerUnits] = {}


def show_units_of(session: "SessionConfig") -> None:
    """Show gains from now on as these loops have them."""
    _units.clear()
    _units.update({config.loop.name: config.units for config in session.loops})


def show_units_told(told: Mapping[str, object]) -> None:
    """Show gains as the configuration in a ledger says, beside what is known already; older ledgers name no units."""
    loops = told.get("loops")
    for one in loops if isinstance(loops, list) else [told]:
        loop = one.get("loop") if isinstance(one, Mapping) else None
        if not isinstance(loop, Mapping):
            continue
        with suppress(ValueError, TypeError, KeyError):
            span, action = float(loop["pv_max"]) - float(loop["pv_min"]), loop.get("action")
            units = ControllerUnits.named(str(loop.get("controller") or "kc-s"), span, action=action)
            _units[str(loop["name"])] = units


def show_units(units: ControllerUnits | None) -> None:
    """Show gains so from now on, whichever loop they are of; None for the units that nobody has chosen."""
    _units.clear()
    if units is not None:
        _units[""] = units


def chosen_units() -> ControllerUnits | None:
    """The units that all loops share, None where nobody has chosen any."""
    return units_of() if _units else None


def units_of(loop: str = "") -> ControllerUnits:
    """The units of a loop by its name; without a name, or for another loop, those that all loops share."""
    known = set(_units.values())
    return _units.get(loop, known.pop() if len(known) == 1 else DEFAULT)
