"""Templates of configurations and pages, and the starter configurations among them."""

from importlib.resources import files
from typing import Any

from retuner.errors import UserError

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


def rendered(name: str, **values: Any) -> str:
    """The text of a template (Jinja) with these values; of a name that is not given it is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  slow to load, for one command

    loader = PackageLoader("retuner", "templates")
    made = Environment(  # noqa: S701  of programs, which no browser reads
        loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    return made.get_template(name).render(zip=zip, **values)
