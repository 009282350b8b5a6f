"""Products: what stands on the core in a folder of its own. The core never imports one; it loads it here by its name,
when a configuration or a person asks for it, so that a run without it needs neither its code nor its libraries.

A new product gets a line here and a folder of its own. Its types may be named under TYPE_CHECKING.
"""

from importlib import import_module
from types import ModuleType

HOMES = {
    "foreign device": "config.described",
    "plants": "config.bench_plants",
    "another schedule": "adaptive.region_model.proposed_boundaries",
    "pretune": "session.pretuning",
    "one plant": "one_plant.loops_of_one_plant",
    "page": "serve.page_beside_run",
    "live view": "live_view.watching_session",
    "what a run leaves": "commands.left_by_run",
}
"""Module of each, below `retuner.`."""


def product(name: str) -> ModuleType:
    """The module of a product."""
    return import_module(f"retuner.{HOMES[name]}")
