"""The Tennessee Eastman plant (Downs & Vogel 1993; revised by Bathelt, Ricker & Jelali 2015): tep-studio (PyPI).

The package brings the authors' C code, its measurement noise, its 28 disturbances (IDV), and the decentralised control
of Ricker (1996) with its gains. One of its loops has ours in its place, at an interval of its own. Licences:
BSD-3-Clause for the package; the model is its authors', for research and education.
"""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plants_of_others.loop import Card, Control, Tripped, package
from retuner import PidGains

TICK_S = 1.8  # The package's own control interval
EVENTS = 8
EXACT = 0x6F  # The package's flag, with its bits for no noise of measurements and of the process
SOURCE = "Ricker 1996, mode 1"


@dataclass(frozen=True, slots=True)
class _Loop:
    """every : ticks a sample. idv : disturbances that reach this loop, switched on and off in turn. answer_h : how long
    its answer to a step is taken for the truth: some thirty times the loop's own time. event_h : between two events.
    """

    every: int
    pv_range: tuple[float, float]
    co_range: tuple[float, float]
    step: float
    idv: tuple[int, ...]
    answer_h: float
    event_h: float


LOOPS = {
    "reactor_temperature": _Loop(5, (100.0, 140.0), (0.0, 100.0), 1.0, (4, 11, 1), 0.25, 2.0),
    "separator_temperature": _Loop(5, (60.0, 100.0), (0.0, 100.0), 2.0, (5, 12, 1), 0.5, 2.0),
    "reactor_pressure": _Loop(10, (2500.0, 3000.0), (0.0, 0.01), 25.0, (2, 1, 8), 1.5, 3.0),
    "separator_level": _Loop(40, (0.0, 100.0), (0.15, 0.35), 6.0, (1, 5, 2), 2.0, 5.0),
    "stripper_level": _Loop(40, (0.0, 100.0), (0.15, 0.35), 6.0, (1, 2, 8), 2.0, 5.0),
}
"""Ranges of transmitters and outputs about mode 1; the last two outputs are ratios to the production index."""


def load() -> Any:  # noqa: ANN401  a module without types
    return package("tep_studio", "Tennessee Eastman")


class Eastman:
    """Mode 1, one loop under control."""

    name = "eastman"
    licence = "BSD-3-Clause; the model: its authors'"

    def __init__(self) -> None:
        self._package = load()
        registry = importlib.import_module("tep_studio.control.registry").RICKER_MODE1
        self.cards, self._outputs = {}, {}
        for name, loop in LOOPS.items():
            spec = getattr(registry, name)
            gains = PidGains(spec.kc, spec.kc / (spec.ti_hours * 3600.0), 0.0)
            dt_s = loop.every * TICK_S
            self.cards[name] = Card(name, dt_s, loop.pv_range, loop.co_range, gains, SOURCE, loop.step)
            self._outputs[name] = float(spec.x0)

    def rest(self, loop: str) -> float:
        """Output to begin with."""
        return self._outputs[loop]

    def times(self, loop: str, _seed: int) -> list[float]:
        """At even intervals."""
        return [LOOPS[loop].event_h * 3600.0 * (i + 1) for i in range(EVENTS)]

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        """A day or two: a step of the setpoint, and a disturbance that comes or goes, in turn."""
        rng = np.random.default_rng([seed, 12])
        card, event_h, hours = self.cards[loop], LOOPS[loop].event_h, []
        sign, on, faults = float(rng.choice([-1.0, 1.0])), 0, list(LOOPS[loop].idv)
        sp = 0.0
        for i in range(EVENTS + 1):
            hours.append((sp, on))
            if i % 2 == 0:
                sp = 0.0 if sp else sign * card.step * float(rng.uniform(0.6, 1.2))
                sign = -sign if not sp else sign
            else:
                on = 0 if on else int(rng.choice(faults))

        def script(t_h: float) -> tuple[float, int]:
            return hours[min(int(t_h / event_h), EVENTS)]

        self.run(controls, loop, event_h * (EVENTS + 1), script, seed=1.0 + seed, flag=None)

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        """No noise, no disturbance."""
        loop = next(iter(controls))
        self.run(controls, loop, seconds / 3600.0, lambda _t: (0.0, 0), seed=1.0, flag=EXACT)

    def run(
        self,
        controls: Mapping[str, Control],
        loop: str,
        hours: float,
        script: Callable[[float], tuple[float, int]],
        *,
        seed: float,
        flag: int | None,
    ) -> None:
        """Hours of the plant. script : by hour, how far the loop's setpoint is moved, and the disturbance."""
        simulator = self._package.TennesseeEastmanProcess(solver_method="Euler")
        # the package's controller with others in the place of some of its loops
        parent = self._package.RickerMultiLoopController

        class Ours(parent):
            shift = 0.0
            ticks: dict[str, int]
            held: dict[str, float]

            def _update(self, loop: Any, setpoint: float, measured: Any) -> float:  # noqa: ANN401  of the package
                name = next((key for key in controls if getattr(self.registry, key).name == loop.name), None)
                if name is None:
                    return float(super()._update(loop, setpoint, measured))
                if not hasattr(self, "ticks"):
                    self.ticks, self.held = {}, {}
                tick = self.ticks.get(name, 0)
                if tick % LOOPS[name].every == 0:
                    sp = setpoint + (0.0 if hasattr(self.setpoints, name) else self.shift)
                    self.held[name] = controls[name](float(sp), float(measured[self._mi[loop.pv]]))
                self.ticks[name] = tick + 1
                return self.held[name]

        controller = Ours(enable_overrides=False)
        seen, _ = simulator.reset(seed=seed, **({} if flag is None else {"ms_flag": flag}))
        controller.reset(seen, time=0.0)
        base, off = controller.setpoints, np.zeros(28)
        for _ in range(round(hours * 3600.0 / TICK_S)):
            moved, fault = script(simulator.time)
            controller.setpoints = replace(base, **{loop: getattr(base, loop) + moved}) if hasattr(base, loop) else base
            controller.shift = moved
            off[:] = 0.0
            if fault:
                off[fault - 1] = 1.0
            action, _ = controller.compute_action(seen, time=simulator.time)
            result = simulator.advance(action, control_interval=TICK_S / 3600.0, disturbances=off)
            seen = result.measurements
            if result.shutdown_status["terminated"]:
                raise Tripped(f"after {simulator.time:.1f} h: {result.shutdown_status['message']}")
