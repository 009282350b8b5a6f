"""The ready profiles: mappings of controllers that exist, as TOML beside this file, with their DBC or EDS."""

import tomllib
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

PACKAGE = "retuner.drivers.profiles"
HERE = "profile:"  # What the name of a file begins with that lies beside the profiles


def profile_names() -> list[str]:
    """All there are, in alphabetical order."""
    return sorted(
        entry.name.removesuffix(".toml") for entry in files(PACKAGE).iterdir() if entry.name.endswith(".toml")
    )


@lru_cache
def profile_settings(name: str) -> dict[str, Any] | None:
    """The [device] section of a profile; None when there is none of this name."""
    if name not in profile_names():
        return None
    return tomllib.loads(files(PACKAGE).joinpath(f"{name}.toml").read_text(encoding="utf-8"))


def described_by(name: str) -> Path:
    """The file that a configuration or a profile names."""
    return Path(str(files(PACKAGE).joinpath(name.removeprefix(HERE)))) if name.startswith(HERE) else Path(name)
