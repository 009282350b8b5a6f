"""Address and patience of the host towards one controller on CAN."""

from dataclasses import dataclass

TIMES = ("sample_time_s", "reply_samples", "reply_floor_s", "silent_samples", "connect_samples", "connect_floor_s")


@dataclass(frozen=True, slots=True)
class CanDeviceSettings:
    """How to reach a controller and how long to wait for it.

    Parameters
    ----------
    node : address of the controller, 1..63.
    sample_time_s : its sample time in s; another one found there is refused.
    variable : scheduling variable for LoopSample.x: "sp", "pv" or "co".
    reply_samples : samples to wait for an answer before the next try.
    reply_floor_s : the same at least in s, for controllers faster than an operating system answers.
    silent_samples : samples without any frame of the node after which it counts as silent.
    connect_samples : samples after which the first connection is given up.
    connect_floor_s : the same at least in s.

    Raises
    ------
    ValueError
        A number is not positive.
    """

    node: int = 1
    sample_time_s: float = 2.0
    variable: str = "sp"
    reply_samples: float = 3.0
    reply_floor_s: float = 0.1
    silent_samples: float = 6.0
    connect_samples: float = 20.0
    connect_floor_s: float = 5.0

    def __post_init__(self) -> None:
        for name in TIMES:
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"device: {name} = {getattr(self, name)}; give a positive number")

    @property
    def reply_s(self) -> float:
        """How long to wait for an answer, s."""
        return max(self.reply_samples * self.sample_time_s, self.reply_floor_s)

    @property
    def silent_s(self) -> float:
        """Age of the last frame at which the node counts as silent, s."""
        return max(self.silent_samples * self.sample_time_s, 3 * self.reply_floor_s)

    @property
    def connect_s(self) -> float:
        """How long the first connection may take, s."""
        return max(self.connect_samples * self.sample_time_s, self.connect_floor_s)
