"""A reactor that swings and a quadruple tank with a right half plane zero: the models of pc-gym (PyPI pcgym, MIT).

Bloor et al. (2024). Only the package's equations are used: its reinforcement learning needs more libraries. Reactor:
temperature by jacket temperature, feed temperature and composition as loads; between 318 and 334 K its gain grows
threefold and its poles turn complex. Tanks: pumps and levels are paired crosswise, since most of each pump's flow goes
to the upper tanks; the other loop's setpoint is the load. Nobody publishes PI gains for them: "published" are ours, the
best PI (truth.py) at the working point, rounded.
"""

import importlib.util
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from plants_of_others.loop import INSTALL, Card, Control, package
from retuner import PidGains

MINUTE_S, EVENTS, NOISE = 60.0, 12, 0.01  # The reactor counts minutes. Noise is this share of a usual step.
HOLD_S = {"reactor": 1800.0, "level 1": 900.0, "level 2": 900.0}
BESIDE = PidGains(10.0, 0.2, 0.0)  # Of the other level, which is not retuned
REST = {"reactor": 300.0, "level 1": 5.0, "level 2": 5.0}
BEGIN = {"reactor": (0.87725, 324.475), "tanks": (0.0899644, 0.1071611, 0.1839959, 0.0942711)}
"""States of rest at these outputs: Ca, T (K); levels (m)."""
FEED_K, FEED_MOL, FEED_LOADS = 350.0, 1.0, ((350.0, 1.0), (347.0, 1.0), (353.0, 1.0), (350.0, 0.97))
State = np.ndarray


def load() -> Any:  # noqa: ANN401  a module without types
    """The package's equations; SystemExit where it is not installed."""
    package("jax", "the reactor")
    found = importlib.util.find_spec("pcgym")
    if found is None or not found.submodule_search_locations:
        raise SystemExit(f"the reactor needs pcgym: {INSTALL}")
    path = Path(found.submodule_search_locations[0]) / "model_classes.py"
    spec = importlib.util.spec_from_file_location("pcgym_model_classes", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


class PcGym:
    """Loop "reactor", and the two levels of the tanks."""

    name = "pc-gym"
    licence = "MIT"

    def __init__(self) -> None:
        models = load()
        self._reactor, self._tanks = models.cstr(int_method="numpy"), models.four_tank(int_method="numpy")
        none = "none; ours"
        self.cards = {
            "reactor": Card("reactor", 3.0, (300.0, 350.0), (280.0, 320.0), PidGains(5.5, 1.04, 0.0), none, 2.0),
            "level 1": Card("level 1", 2.0, (0.0, 0.5), (0.0, 10.0), PidGains(148.0, 1.09, 0.0), none, 0.01),
            "level 2": Card("level 2", 2.0, (0.0, 0.5), (0.0, 10.0), PidGains(90.0, 0.92, 0.0), none, 0.01),
        }

    def rest(self, loop: str) -> float:
        """Output to begin with."""
        return REST[loop]

    def times(self, loop: str, _seed: int) -> list[float]:
        """At even intervals."""
        return [HOLD_S[loop] * (i + 1) for i in range(EVENTS)]

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        """Setpoint steps and loads in turn."""
        rng = np.random.default_rng([seed, 16])
        sp, load, script, step = 0.0, 0, [], self.cards[loop].step
        for i in range(EVENTS + 1):
            script.append((sp, load))
            if i % 2 == 0:
                sp = 0.0 if sp else float(rng.choice([-1, 1])) * step
            else:
                load = 0 if load else int(rng.integers(1, len(FEED_LOADS)))
        self._run(controls, loop, script, HOLD_S[loop], rng)

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        """No noise, no loads."""
        self._run(controls, next(iter(controls)), [(0.0, 0)], seconds, None)

    def _run(
        self,
        controls: Mapping[str, Control],
        loop: str,
        script: list[tuple[float, int]],
        hold_s: float,
        rng: np.random.Generator | None,
    ) -> None:
        card, state = self.cards[loop], np.array(BEGIN["reactor" if loop == "reactor" else "tanks"])
        noise = NOISE * card.step if rng else 0.0
        levels = state[:2].copy()
        other = {"level 1": "level 2", "level 2": "level 1"}.get(loop, "")
        beside = controls.get(other) or (_Held(self.cards[other]) if other else None)
        for sp, load in script:
            for _ in range(round(hold_s / card.dt_s)):
                more = noise * rng.standard_normal(2) if rng else np.zeros(2)
                if beside is None:
                    co = controls[loop](float(levels[1]) + sp, float(state[1] + more[0]))
                    state = self._fed(state, co, FEED_LOADS[load], card.dt_s)
                    continue
                mine = 0 if loop == "level 1" else 1
                co = controls[loop](float(levels[mine]) + sp, float(state[mine] + more[0]))
                off = (0.0, 0.5, -0.5, 1.0)[load] * card.step
                else_ = beside(float(levels[1 - mine]) + off, float(state[1 - mine] + more[1]))
                pumps = np.array([else_, co] if mine == 0 else [co, else_])  # level 1 by pump 2, level 2 by pump 1
                state = _later(lambda x, pumps=pumps: np.array(self._tanks(x, pumps)), state, card.dt_s)

    def _fed(self, state: State, co: float, feed: tuple[float, float], dt_s: float) -> State:
        given = np.array([co, *feed])
        return _later(lambda x: np.array(self._reactor(x, given)), state, dt_s / MINUTE_S)


def _later(slope: Callable[[State], State], x: State, h: float) -> State:
    """One step of the classic Runge-Kutta method: short against the plants' times."""
    a = slope(x)
    b = slope(x + h / 2 * a)
    c = slope(x + h / 2 * b)
    return np.asarray(x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c)))


class _Held:
    """The other level under its gains, begun at the output of rest."""

    def __init__(self, card: Card) -> None:
        self._gains, self._dt_s, self._sum = BESIDE, card.dt_s, REST[card.name]

    def __call__(self, sp: float, pv: float) -> float:
        self._sum += self._gains.ki * (sp - pv) * self._dt_s
        return min(max(self._gains.kp * (sp - pv) + self._sum, 0.0), 10.0)
