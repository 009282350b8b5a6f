"""Options that several commands share, and how a dataclass of options becomes a command's signature."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from retuner.errors import UserError, user_input

if TYPE_CHECKING:  # slow to load, and most commands have no configuration
    from retuner.config.model import Config
    from retuner.config.session_config import SessionConfig
    from retuner.schedule.controller_units import ControllerUnits

ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).")]
Session = Annotated[Path, typer.Argument(metavar="SESSION", help="Folder of a session, finished or running.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Interface = Annotated[str | None, typer.Option("--interface", "-i", help="python-can interface.")]
Channel = Annotated[str | None, typer.Option("--channel", "-c", help="Channel of the interface.")]
Loop = Annotated[str | None, typer.Option("--loop", metavar="NAME", help="Which loop, where there are several.")]
By = Annotated[str | None, typer.Option(help="Who requests it; default: the user of this process.")]
Note = Annotated[str, typer.Option(help="Why, for the ledger.")]

Controller = Annotated[
    str | None,
    typer.Option(
        metavar="UNITS",
        help="Units of gains, given and shown: kc-s, gain-min, pb-rpm and so on; -ideal behind for that form.",
    ),
]
ActionOption = Annotated[
    str | None,
    typer.Option("--action", help="With --controller: reverse or direct acting; else the sign of the gain says it."),
]
PvSpan = Annotated[float | None, typer.Option(help="Span of pv, in its own unit; gain and pb are told of it.")]
CONTROLLER = "--controller, --action, --pv-span"

Options = TypeVar("Options")


def signed_by(options: type[Options]) -> Callable[[Callable[[Options], int]], Callable[..., int]]:
    """Make a function of a dataclass a command with an option for each field; its help is the class's docstring."""

    def signed(work: Callable[[Options], int]) -> Callable[..., int]:
        @wraps(options, updated=())
        def called(**given: Any) -> int:
            return work(options(**given))

        return called

    return signed


def on_bus(config: "Config", interface: str | None, channel: str | None) -> "Config":
    """The configuration with the bus that the command line names."""
    named = {"interface": interface, "channel": channel}
    changes = {name: value for name, value in named.items() if value is not None}
    return config.model_copy(update={"bus": config.bus.model_copy(update=changes)}) if changes else config


def all_on_bus(session: "SessionConfig", interface: str | None, channel: str | None) -> "SessionConfig":
    """The same for all loops of a session.

    Raises
    ------
    UserError
        They hang on several buses: which one is meant?
    """
    if (interface or channel) is not None and len(session.buses) > 1:
        raise UserError(
            f"--interface, --channel: name one bus, and the loops depend on {len(session.buses)}; name them in the file"
        )
    return replace(session, loops=tuple(on_bus(config, interface, channel) for config in session.loops))


NOT_PERCENT = {(0.0, 1.0): "0..1", (4.0, 20.0): "mA"}
"""Limits of co that are another unit's, and how --scale calls it."""


def controller_units(
    name: str | None,
    pv_span: float | None,
    action: str | None,
    co_limits: tuple[float | None, float | None] = (None, None),
) -> "ControllerUnits | None":
    """The units that the options name, None without a name. co_limits : those of co that the options give.

    Raises
    ------
    UserError
        There are no such units, they need a span that is not given, or co is not in percent of its own.
    """
    from retuner.schedule.controller_units import ControllerUnits  # noqa: PLC0415  most commands need none

    if name is not None and pv_span is None and name.split("-")[0] in {"gain", "pb"}:
        raise UserError(f"--controller {name} is told of the span of pv: give --pv-span")
    recorded = next((told for limits, told in NOT_PERCENT.items() if limits == co_limits), None)
    if name is not None and recorded and name.split("-")[0] in {"gain", "pb"}:
        raise UserError(f"--controller {name} counts co in percent: give --scale co={recorded}:0..100, and limits so")
    if name is None:
        if action is not None:
            raise UserError("--action needs --controller: say how the gains are given, as in --controller pb-rpm")
        return None
    with user_input(CONTROLLER):
        return ControllerUnits.named(name, pv_span, action=action)
