"""Level loops of the Tennessee Eastman plant that swing slowly, Kc tau_I being too small: what `diagnose` says of them.

Each record is 1,000 samples of a PI loop with k' Kc tau_I from 0.08 to 0.5 under the plant's own noise and loads, some
with setpoint steps: half to twice the published gain. Settings are held to k' Kc tau_I of 4 (Skogestad 2003, SIMC's
integral time), k' from the answer of the plant at rest. Where nothing swings, or its own limits stop a loop, the cause
is another; so the table has the period and how far pv moves.
"""

import argparse
import math
import sys

import numpy as np
from numpy.random import Generator

from plants_of_others.eastman import LOOPS, Eastman
from plants_of_others.loop import Card, Tripped
from plants_of_others.truth import StepTest, answer, fitted
from retuner import PidGains
from retuner.diagnosing import diagnose

LEVELS = ("separator_level", "stripper_level")
HOURS, SAMPLES, FIRST = 24.0, 1000, 200
W = 2.0 * math.pi / 7200.0
"""Of a swing of two hours, rad/s: k' is w |G(jw)| there."""
PRODUCTS, GAINS = (0.08, 0.5), (0.5, 1.0, 2.0)


class Pi:
    """A PI controller that keeps what it saw. rows : sp, pv, co."""

    def __init__(self, card: Card, gains: PidGains, co: float) -> None:
        self.card, self.gains, self.total, self.rows = card, gains, co, list[tuple[float, float, float]]()

    def __call__(self, sp: float, pv: float) -> float:
        """One interval; the integral is held at co's limits."""
        part = self.gains.kp * (sp - pv)
        wanted = part + self.total + self.gains.ki * (sp - pv) * self.card.dt_s
        co = min(max(wanted, self.card.co_range[0]), self.card.co_range[1])
        self.total = co - part
        self.rows.append((sp, pv, co))
        return co


def record(plant: Eastman, name: str, slope: float, rng: Generator, seed: int) -> tuple[Pi, float]:
    """A loop that was run, and its k' Kc tau_I. slope : k' of the loop."""
    product = float(np.exp(rng.uniform(*np.log(PRODUCTS))))
    kp = plant.cards[name].published.kp * float(rng.choice(GAINS))
    pi = Pi(plant.cards[name], PidGains(kp, slope * kp * abs(kp) / product), plant.rest(name))
    event_h, step = float(rng.uniform(3.0, 5.0)), float(rng.choice((0.0, 0.0, 3.0, -3.0)))
    load = int(rng.choice(LOOPS[name].idv))

    def script(t_h: float) -> tuple[float, int]:
        event = int(t_h / event_h)
        return step * (event % 2), load * (event // 2 % 2)

    plant.run({name: pi}, name, HOURS, script, seed=1.0 + seed, flag=None)
    return pi, product


def measure(options: argparse.Namespace) -> int:
    """Make the records and print what is said of each."""
    plant, named, products = Eastman(), 0, []
    tests = {name: StepTest(6 * 3600.0, LOOPS[name].answer_h * 3600.0, 0.005, "search") for name in LEVELS}
    found = {
        name: fitted(seen, dt_s)[0]
        for name, test in tests.items()
        for seen, _, dt_s in [answer(plant, plant.cards[name], test)]
    }
    slopes = {name: W * float(np.abs(process.response(np.array([W])))[0]) for name, process in found.items()}
    for i in range(options.sessions):
        name, rng = LEVELS[i % 2], np.random.default_rng([options.seed, i])
        try:
            pi, product = record(plant, name, slopes[name], rng, options.seed + i)
        except Tripped as stopped:
            sys.stdout.write(f"{i} {name}: {stopped}\n")
            continue
        sp, pv, co = np.array(pi.rows[FIRST : FIRST + SAMPLES]).T
        told = diagnose(np.arange(len(pv)) * pi.card.dt_s, sp, pv, co, gains=pi.gains)
        best, after = told.recommended, ""
        named += str(told.cause) == "slow_integrating"
        if best is not None:
            products.append(slopes[name] * best.kp**2 / abs(best.ki))
            after = f", then {products[-1]:.2f} with {best.kp / pi.gains.kp:.2f} times the gain"
        period = 2.0 * math.pi / math.sqrt(slopes[name] * abs(pi.gains.ki)) / pi.card.dt_s
        sys.stdout.write(
            f"{i} {name}: k' Kc tau_I {product:.2f}, period {period:.0f} samples, pv's deviation {np.std(pv - sp):.2f}"
            f": {told.cause} {told.diagnosis.confidence:.0%}{after}\n"
        )
        sys.stdout.flush()
    inside = sum(3.8 <= one <= 4.2 for one in products)
    sys.stdout.write(
        f"named {named} of {options.sessions}; settings {len(products)}, k' Kc tau_I 3.8 to 4.2 in {inside}\n"
    )
    return 0
