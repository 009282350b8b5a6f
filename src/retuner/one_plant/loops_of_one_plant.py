"""Which loops of a session, or controllers of a program, are on one plant."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.question import OTHER_LOOP, Question
from retuner.config import Config
from retuner.config.plants import ModelSection
from retuner.decisions.decider import Answer, without_decision
from retuner.one_plant.change_among_loops import (
    IN_PART,
    NO_VERDICT,
    NOT_SURVIVED,
    DecideAmong,
    OnePlant,
    half_way,
    without_change,
)

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


def answered_again(question: Question, code: str, trouble: str) -> Answer:
    """What DecideAmong entered in place of a decision, for a replay. code, trouble : as the ledger has them."""
    if code == NOT_SURVIVED:
        return Answer(without_change(decide(question), trouble))
    if code == OTHER_LOOP and trouble.endswith(NO_VERDICT):
        return Answer(decide(replace(question, spoilt=trouble)))
    if not trouble.startswith(IN_PART):
        return without_decision(code, trouble)
    whole = decide(question).proof
    assert whole is not None
    assert whole.gains is not None
    return Answer(replace(decide(half_way(question, whole.gains)), reason=trouble))
