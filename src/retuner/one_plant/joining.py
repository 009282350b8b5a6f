"""Which loops of a session, or controllers of a program, are on one plant."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from retuner.config import Config
from retuner.config.plants import ModelSection
from retuner.one_plant.deciding import DecideAmong, OnePlant

if TYPE_CHECKING:
    from retuner.session.loop_session import LoopSession


def plant_of(config: Config) -> str:
    """Name of the plant that a loop shares with others, empty for none: [loop] plant, or the bench's."""
    plant = config.device.plant if config.device else None
    return config.loop.plant or (plant.shared if isinstance(plant, ModelSection) else "")


def join(configs: Sequence[Config], sessions: "Sequence[LoopSession]") -> None:
    """Have the loops of each plant decide with regard to each other."""
    groups: dict[str, list[LoopSession]] = {}
    for config, session in zip(configs, sessions, strict=True):
        if name := plant_of(config):
            groups.setdefault(name, []).append(session)
    for loops in groups.values():
        plant = OnePlant([one.retuner for one in loops])
        for i, one in enumerate(loops if len(loops) > 1 else ()):
            one.decider = DecideAmong(one.decider, plant, i)
