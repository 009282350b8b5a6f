"""Distillation columns as published transfer functions, with the gains that are published for them; nothing to install.

Wood & Berry (1973): methanol and water, 2 x 2, and what the feed does to it.

Gains: BLT of Luyben (1986), detuned until the multivariable loop keeps a log modulus of 2 dB a loop. Minutes in the
papers, seconds here. All loops of a column act on each other; compositions in percent, noise of NOISE of a usual step.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from cases.plant import HeldPlant

from plants_of_others.loop import Card, Control
from retuner import LinearProcess, PidGains

MINUTE_S, DT_S = 60.0, 20.0
NOISE, EVENTS, EVENT_MIN = 0.01, 12, 150.0
Element = tuple[float, float, tuple[float, ...], tuple[float, ...]]  # Gain, dead time, lags, leads; minutes


@dataclass(frozen=True, slots=True)
class Column:
    """rows : by output, one element an input. feed : by output, one element a disturbance. step : of each setpoint.
    load : size of each disturbance. blt : kc and tau_I (minutes) by loop.
    """

    rows: tuple[tuple[Element, ...], ...]
    feed: tuple[tuple[Element, ...], ...]
    step: tuple[float, ...]
    load: tuple[float, ...]
    blt: tuple[tuple[float, float], ...]
    source: str


def _lag(k: float, theta: float, *lags: float, lead: float = 0.0) -> Element:
    return k, theta, lags, (lead,) if lead else ()


COLUMNS = {
    "wood-berry": Column(
        ((_lag(12.8, 1.0, 16.7), _lag(-18.9, 3.0, 21.0)), (_lag(6.6, 7.0, 10.9), _lag(-19.4, 3.0, 14.4))),
        ((_lag(3.8, 8.1, 14.9),), (_lag(4.9, 3.4, 13.2),)),
        (0.75, 0.75),
        (0.34,),
        ((0.375, 8.29), (-0.075, 23.6)),
        "Wood & Berry 1973; BLT of Luyben 1986",
    )
}


class Distillation:
    """All loops of one column."""

    licence = "published equations"

    def __init__(self, name: str) -> None:
        self.name, self._column = name, COLUMNS[name]
        self.cards = {}
        for i, ((kc, tau_i), step) in enumerate(zip(self._column.blt, self._column.step, strict=True)):
            gains, reach = PidGains(kc, kc / (tau_i * MINUTE_S), 0.0), 20 * step
            card = Card(f"y{i + 1}", DT_S, (-reach, reach), (-50.0, 50.0), gains, self._column.source, step)
            self.cards[card.name] = card

    def rest(self, _loop: str) -> float:
        """Everything counts from rest."""
        return 0.0

    def times(self, _loop: str, _seed: int) -> list[float]:
        """At even intervals."""
        return [EVENT_MIN * MINUTE_S * (i + 1) for i in range(EVENTS)]

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        """Steps of this loop's setpoint, of the other setpoints, and of the feed, in turn."""
        rng = np.random.default_rng([seed, 14])
        sps, loads, script = [0.0] * len(self.cards), [0.0] * len(self._column.load), []
        mine = list(self.cards).index(loop)
        for i in range(EVENTS + 1):
            script.append((list(sps), list(loads)))
            which = mine if i % 2 == 0 else int(rng.integers(len(sps)))
            if i % 4 == 3:
                which = int(rng.integers(len(loads)))
                loads[which] = 0.0 if loads[which] else float(rng.choice([-1, 1])) * self._column.load[which]
            else:
                sps[which] = 0.0 if sps[which] else float(rng.choice([-1, 1])) * self._column.step[which]
        self._run(controls, script, EVENT_MIN * MINUTE_S, rng)

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        """Nothing but what the controls do."""
        self._run(controls, [([0.0] * len(self.cards), [0.0] * len(self._column.load))], seconds, None)

    def _run(
        self,
        controls: Mapping[str, Control],
        script: list[tuple[list[float], list[float]]],
        hold_s: float,
        rng: np.random.Generator | None,
    ) -> None:
        everybody = [controls.get(name) or _Published(card) for name, card in self.cards.items()]
        rows = [[_plant(cell) for cell in row] for row in self._column.rows]
        feed = [[_plant(cell) for cell in row] for row in self._column.feed]
        noise = [NOISE * step if rng else 0.0 for step in self._column.step]
        y = [0.0] * len(rows)
        for sps, loads in script:
            for _ in range(int(hold_s / DT_S)):
                read = [
                    a + (size * float(rng.standard_normal()) if rng else 0.0) for a, size in zip(y, noise, strict=True)
                ]
                u = [control(sp, pv) for control, sp, pv in zip(everybody, sps, read, strict=True)]
                y = [
                    sum(cell.move(x) for cell, x in zip(row, u, strict=True))
                    + sum(cell.move(x) for cell, x in zip(more, loads, strict=True))
                    for row, more in zip(rows, feed, strict=True)
                ]


class _Published:
    """The published gains, in the law's plainest form."""

    def __init__(self, card: Card) -> None:
        self._gains, self._dt_s, self._sum = card.published, card.dt_s, 0.0

    def __call__(self, sp: float, pv: float) -> float:
        self._sum += self._gains.ki * (sp - pv) * self._dt_s
        return self._gains.kp * (sp - pv) + self._sum


def _plant(cell: Element) -> HeldPlant:
    k, theta, lags, leads = cell
    return HeldPlant(
        LinearProcess(k, tuple(x * MINUTE_S for x in lags), tuple(x * MINUTE_S for x in leads), theta * MINUTE_S), DT_S
    )
