"""Which actions a controller has."""

from enum import StrEnum


class ControllerKind(StrEnum):
    """Actions that a rule may use."""

    P = "p"
    PI = "pi"
    PID = "pid"
