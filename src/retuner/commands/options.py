"""Options that several commands share, and how a dataclass of options becomes a command's signature."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

if TYPE_CHECKING:  # slow to load, and most commands have no configuration
    from retuner.config.model import Config

ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).")]
Session = Annotated[Path, typer.Argument(metavar="SESSION", help="Folder that a run leaves, or fills right now.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Interface = Annotated[
    str | None, typer.Option("--interface", "-i", help="python-can interface, as python-can spells it.")
]
Channel = Annotated[str | None, typer.Option("--channel", "-c", help="Channel of the interface.")]
By = Annotated[str | None, typer.Option(help="Who orders it; default: the user of this process.")]
Note = Annotated[str, typer.Option(help="Why, for the ledger.")]

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
