"""One loop of somebody else's plant: its card, and what may stand in the place of its controller.

A plant calls what stands there with (sp, pv) once an interval and applies what comes back. That is a
`retuner.PidController` as a user would have it, in mode auto or off; or, for the truth, an output that is stepped.
"""

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from retuner import Action, Decision, Mode, PidController, PidGains, RetunerSettings
from retuner.adaptive.guard.guard_settings import GuardSettings

INSTALL = "pip install tclab tep-studio bsm2-python gym-electric-motor jsbsim jax && pip install --no-deps pcgym"
"""Brings all plants. pc-gym only gives its equations; what its reinforcement learning needs stays away."""


def package(module: str, who: str) -> Any:  # noqa: ANN401  a module without types
    """A module that brings a plant. who : what needs it.

    Raises SystemExit: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as missing:
        raise SystemExit(f"{who} needs {missing.name}: {INSTALL}") from None


Control = Callable[[float, float], float]
OPENED = 8.0  # Factor to which a change, and the sum of all changes, is held where the limits are opened
LOST_SPANS = 3.0  # A loop further from its setpoint than so many spans is lost


class Tripped(Exception):  # noqa: N818  it is no error of the program
    """The plant's own interlocks shut it down, or the loop was lost: how it went is told in the message."""


@dataclass(frozen=True, slots=True)
class Card:
    """What its makers say of a loop.

    dt_s : interval of its controller, seconds. pv_range, co_range : of transmitter and output, in their units.
    published : the gains that its makers, or a paper, give it; source : where. step : a usual setpoint step, pv units.
    """

    name: str
    dt_s: float
    pv_range: tuple[float, float]
    co_range: tuple[float, float]
    published: PidGains
    source: str
    step: float

    @property
    def span(self) -> float:
        """Of pv."""
        return self.pv_range[1] - self.pv_range[0]

    def settings(self, *, opened: bool) -> RetunerSettings:
        """Of a retuner that may write by itself."""
        guard = GuardSettings().opened(OPENED) if opened else GuardSettings()
        return RetunerSettings(self.dt_s, self.span, Mode.AUTO, guard=guard, pv_range=self.pv_range)


class Plant(Protocol):
    """Somebody else's plant with some loops.

    name, licence : for the table. cards : the loops that it lets others control, by name.
    """

    name: str
    licence: str
    cards: Mapping[str, Card]

    def rest(self, loop: str) -> float:
        """Output to begin with."""

    def times(self, loop: str, seed: int) -> list[float]:
        """When something happens to that loop in a session, seconds."""

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        """A normal session, with setpoints and loads for that loop; who is not named runs as published.

        Raises Tripped: the plant shut itself down.
        """

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        """So long without noise, loads or setpoint steps."""


@dataclass
class Track:
    """What a loop did: setpoint, pv and output of each sample."""

    sp: list[float] = field(default_factory=list)
    pv: list[float] = field(default_factory=list)
    co: list[float] = field(default_factory=list)

    def add(self, sp: float, pv: float, co: float) -> float:
        """One sample more; its output."""
        self.sp.append(sp)
        self.pv.append(pv)
        self.co.append(co)
        return co


class Controlled:
    """`retuner.PidController` in a loop; begins without a bump at the output of rest.

    watched : retuner may write; else the gains stay.
    """

    def __init__(self, card: Card, gains: PidGains, co0: float, *, watched: bool, opened: bool = False) -> None:
        wanted = card.settings(opened=opened) if watched else None
        self.pid = PidController(
            gains, dt_s=card.dt_s, pv_range=card.pv_range, co_range=card.co_range, mode=Mode.OFF, settings=wanted
        )
        self.card, self.track = card, Track()
        self.decisions: list[Decision] = []
        self.gains: list[PidGains] = []
        self._co0: float | None = co0

    def __call__(self, sp: float, pv: float) -> float:
        """One sample."""
        if not abs(sp - pv) < LOST_SPANS * self.card.span:
            raise Tripped(f"{self.card.name} is lost: pv {pv:.4g} at a setpoint of {sp:.4g}")
        co = self.pid.step(sp, pv, manual_co=self._co0)
        self._co0 = None
        if self.pid.decision is not None:
            self.decisions.append(self.pid.decision)
        self.gains.append(self.pid.gains)
        return self.track.add(sp, pv, co)

    @property
    def writes(self) -> list[Decision]:
        """Decisions that changed gains."""
        return [d for d in self.decisions if d.action in {Action.WRITE, Action.RESTORE} and d.gains_after is not None]

    def gains_at(self, t_s: float) -> PidGains:
        """In force at that time of the session."""
        return self.gains[min(max(math.floor(t_s / self.card.dt_s), 0), len(self.gains) - 1)]


class Stepped:
    """An output that follows a controller for some samples, then stands still for as many, and then is stepped."""

    def __init__(self, control: Control, settle: int, hold: int, step: float) -> None:
        self._control, self._settle, self._hold, self._step = control, settle, hold, step
        self.track, self.co0 = Track(), 0.0

    def __call__(self, sp: float, pv: float) -> float:
        """One sample."""
        i = len(self.track.pv)
        if i < self._settle:
            self.co0 = self._control(sp, pv)
        return self.track.add(sp, pv, self.co0 + (self._step if i >= self._settle + self._hold else 0.0))
