"""What the bus and the machines suffer, drawn anew from time to time: calm, lossy, storm, cut, all at once."""

from dataclasses import dataclass
from enum import Enum
from random import Random

CHANGE_EVERY = 64  # steps between draws of the weather


class Fault(Enum):
    """What may happen to a frame on its way to one receiver."""

    LOSS = 0
    DUPLICATION = 1
    DELAY = 2
    CORRUPTION = 3
    GARBLING = 4
    TRUNCATION = 5
    REPLAY = 6
    REORDERING = 7


FAULTS = tuple(Fault)
MIXED = (5, 3, 5, 3, 1, 1, 2, 3)
LATE = (1, 1, 6, 0, 0, 0, 0, 0)


@dataclass(slots=True)
class Weather:
    """Rates that hold for a while.

    frame_fault : share of frames (per receiver) to which something happens. weights : of what, in Fault's order.
    out_cut, back_cut : nothing passes to the device, or from it. mishap : share of steps with a mishap of a machine.
    intruder : share of steps in which somebody else sends a frame. stall : share of steps in which the host misses its
    turn.
    """

    frame_fault: float = 0.0
    weights: tuple[int, ...] = MIXED
    out_cut: bool = False
    back_cut: bool = False
    mishap: float = 0.0
    intruder: float = 0.0
    stall: float = 0.0


CALM = Weather()


def draw(rng: Random) -> Weather:
    """The next weather; something happens in every one of them."""
    kind = rng.random()
    mishap, intruder, stall = rng.choice((0.002, 0.01, 0.03)), rng.choice((0.0, 0.02, 0.1, 0.3)), rng.choice((0, 0.02))
    if kind < 0.1:
        return late(rng)
    if kind < 0.3:
        return Weather(0.02, MIXED, mishap=mishap, intruder=intruder, stall=stall)
    if kind < 0.55:
        return Weather(rng.uniform(0.05, 0.3), MIXED, mishap=mishap, intruder=intruder, stall=stall)
    if kind < 0.75:
        weights = tuple(rng.choice((0, 1, 6)) for _ in FAULTS)
        weights = weights if any(weights) else MIXED
        return Weather(rng.uniform(0.05, 0.5), weights, mishap=mishap, intruder=intruder, stall=stall)
    if kind < 0.87:
        one_way = rng.random()
        return Weather(0.1, MIXED, out_cut=one_way < 0.66, back_cut=one_way > 0.33, mishap=mishap, stall=stall)
    return Weather(0.05, MIXED, mishap=0.1, intruder=intruder, stall=0.2)


def late(rng: Random) -> Weather:
    """Frames come late, many of them when nobody waits for them any more, and nothing else happens."""
    return Weather(rng.uniform(0.1, 0.5), LATE)
