"""What a run was made with: enough to do it again, and to say for which versions byte identity may be claimed.

The same frames give the same decisions byte for byte where all of this is equal: linear algebra libraries round
differently from release to release and from processor to processor.
"""

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from retuner import adaptive, drivers, schedule
from retuner.adaptive.fit.engine import engine_name
from retuner.config.loading import text_as_run
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig

ROOMS = (schedule, adaptive, drivers)
"""The code that lies between frames and decisions."""
PACKAGES = ("retuner", "numpy", "scipy", "filterpy", "python-can", "cantools")
"""What the way from frames to decisions goes through."""
BLOCK = 1 << 20  # bytes read at a time


def versions() -> dict[str, str]:
    """Versions of everything between frames and decisions, by name; code: a hash of the rooms' own, which tells more
    than the number of a release; engine: which one computes the fits, they are equal to rounding and not to the bit.
    """
    made_with = {name: version(name) for name in PACKAGES}
    return {
        **made_with,
        "engine": engine_name(),
        "code": code(),
        "python": platform.python_version(),
        "system": platform.system(),
        "machine": platform.machine(),
    }


def code() -> str:
    """The first 12 digits of a SHA-256 over the source of the rooms."""
    digest = hashlib.sha256()
    for room in ROOMS:
        folder = Path(next(iter(room.__path__)))
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def differences(recorded: Mapping[str, str]) -> list[str]:
    """Which versions are others here, in words; empty when all are equal."""
    here = versions()
    names = sorted({*recorded, *here})
    return [
        f"{name} {recorded.get(name, 'none')} then, {here.get(name, 'none')} here"
        for name in names
        if recorded.get(name) != here.get(name)
    ]


def session_identity(
    session: SessionConfig, text: str, changes: Mapping[tuple[str, str], str | bool]
) -> tuple[str, dict[str, object]]:
    """The configuration as it is run, as text, and what a session's first row says of all that it is made with.

    session : as read, with the bus that is meant. text : as its author wrote it. changes : (section, key) to its value,
    as the command line has it.
    """
    text = text_as_run(text, replace(session, loops=tuple(_in_mode(one, changes) for one in session.loops)), changes)
    seeds = [one.device.seed if one.device else None for one in session.loops]
    return text, {
        "versions": versions(),
        "seed": seeds if session.several else seeds[0],
        "config_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "overrides": {".".join(place): value for place, value in changes.items()},
    }


def _in_mode(config: Config, changes: Mapping[tuple[str, str], str | bool]) -> Config:
    """A loop's configuration in the mode that the command line names."""
    mode = changes.get(("adaptation", "mode"), config.adaptation.mode)
    return config.model_copy(update={"adaptation": config.adaptation.model_copy(update={"mode": mode})})


def file_sha256(*paths: Path) -> str | None:
    """SHA-256 of a file, or of several one after the other; None when one cannot be read."""
    digest = hashlib.sha256()
    try:
        for path in paths:
            with path.open("rb") as stream:
                while block := stream.read(BLOCK):
                    digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()
