"""Templates of configurations and pages, and the starter configurations among them."""

from functools import cache
from importlib.resources import files
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from retuner.errors import UserError

if TYPE_CHECKING:
    from jinja2 import Environment

STARTER = "starter"


def profiles() -> list[str]:
    """Controllers whose description comes along."""
    found = (entry.name for entry in files("retuner").joinpath("templates").iterdir())
    return sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml") and name != f"{STARTER}.toml")


def starter(profile: str = "") -> str:
    """The starter configuration as TOML text, or that of a device's profile.

    Raises UserError: there is no such profile.
    """
    if profile and profile not in profiles():
        raise UserError(f"--profile {profile}: there is {', '.join(profiles())}")
    return files("retuner").joinpath("templates", f"{profile or STARTER}.toml").read_text(encoding="utf-8")


@cache
def palette() -> str:
    """The colours of every page and drawing, light and dark."""
    return files("retuner.templates").joinpath("palette.css").read_text(encoding="utf-8")


def rendered(name: str, **values: Any) -> str:
    """The text of a template (Jinja) with these values; of a name that is not given it is an error."""
    return _environment().get_template(name).render(values)


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape  # noqa: PLC0415  slow to load

    made = Environment(
        loader=PackageLoader("retuner", "templates"), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=True, autoescape=select_autoescape(("html.jinja",)),
    )  # fmt: skip
    made.globals["zip"] = zip
    made.filters["runs"] = lambda items, name: [(key, [*some]) for key, some in groupby(items, attrgetter(name))]
    return made
