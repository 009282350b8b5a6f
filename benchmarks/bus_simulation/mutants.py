"""The firmware with one thing wrong each: what an examination and the simulation must find.

Each is a name and one change of a text in drivers/firmware/retuner_device.c (mutants.toml). The first group are single
layers of the protocol taken away; where another layer does the same work, only an examination that looks at each layer
sees it.
"""

import tomllib
from pathlib import Path
from typing import NamedTuple

TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


class Mutant(NamedTuple):
    """One change: old stands there exactly once."""

    name: str
    old: str
    new: str


MUTANTS = tuple(Mutant(name, *texts) for name, texts in TEXTS["device"].items())
"""All mutants of the device. A new epoch at every boot is the board's business: that is tried with the library."""
MUTANTS_OF_THE_STORE = tuple(Mutant(name, *texts) for name, texts in TEXTS["store"].items())
