"""Templates of configurations and pages, and the starter configurations among them."""

from importlib.resources import files

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
