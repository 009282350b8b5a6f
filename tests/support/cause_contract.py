"""What every look at a record that may name a cause must do: find its own, leave the others alone, ask no units."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from pi_loop import Lag, pi_loop

from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

Look = Callable[[Window], Diagnosis | None]
UNITS = ((1.0, 1.0, 60.0), (0.01, 1.0, 1.0), (37.0, 0.16, 0.2), (1e4, 41.0, 3600.0))
"""Factors of pv, co and time: minutes, shares, milliamperes, raw counts."""


def loop(kc: float, tau_i_s: float, seed: int, *, noise: float = 0.05, load: float = 0.0, hours: float = 1.0) -> Window:
    """A PI loop round a lag of 30 s with a dead time of 6 s at one sample a second: setpoint steps, perhaps a load."""
    i = np.arange(int(3600 * hours))
    white, process = np.random.default_rng(seed).normal(size=len(i)), Lag(30.0, 6, at=50.0)
    loads = load * np.sin(i / 15.0)
    return pi_loop(PidGains(kc, kc / tau_i_s), process, 50.0 + 5.0 * (i // 600 % 2), noise * white, loads, co0=50.0)


def others() -> list[Window]:
    """Records of loops in which nothing special is: well tuned, sluggish, aggressive, noisy, swung from outside."""
    return [
        loop(2.5, 30.0, 1),
        loop(0.5, 60.0, 2),
        loop(4.5, 20.0, 3),
        loop(2.5, 30.0, 4, noise=1.0),
        loop(2.5, 30.0, 5, load=4.0),
    ]


def in_units(window: Window, pv: float, co: float, time: float) -> Window:
    """The same record in other units."""
    return replace(window, t_s=window.t_s * time, sp=window.sp * pv, pv=window.pv * pv, co=window.co * co)


def assert_keeps_contract(look: Look, own: Window) -> None:
    """A look finds its own record, in any units and offset, the same every time; and says nothing of any other."""
    found = look(own)
    assert found == look(own)
    assert found.reason[0].islower()
    assert ": " in found.reason, "what is seen, a colon, what to do"
    for factors in UNITS:
        again = look(in_units(own, *factors))
        assert again is not None, factors
        assert again.cause == found.cause
    shifted = replace(own, sp=own.sp + 100.0, pv=own.pv + 100.0)
    assert (again := look(shifted)) is not None
    assert again.cause == found.cause
    assert [look(other) for other in others()] == [None] * len(others())
