"""Plants from physics: balances of mass, heat, charge and momentum, with valves, sensors and transport.

tank            level; equal-percentage valve on the inlet, outflow by the root of the level (Torricelli)
ph              pH of a carbonate-buffered stream neutralised with base: electroneutrality (Henson & Seborg 1994)
reactor         temperature of a stirred tank with an exothermic first-order reaction, jacket temperature as output
exchanger       outlet temperature of a heater whose gain, lag and dead time all go with the flow through it
oven            the oven of the demonstration (drivers/plants/oven_plant.py), radiation and burst firing
drive           speed of a motor with a fan as load and a weakened field above its base speed
"""

import math
from collections.abc import Callable
from functools import partial

from retuner.drivers.plants.oven_plant import OvenPlant, OvenSettings
from schedules.ode import Equations, InMotion, State
from schedules.subject import Subject, sampling

TANK_AREA, VALVE_RANGE, TANK_LAG_S = 12.0, 30.0, 6.0


def _tank(x: State, u: float, _w: float) -> list[float]:
    level, valve = x
    inflow = 10.0 * VALVE_RANGE ** (min(max(valve, 0.0), 100.0) / 100.0 - 1.0)
    return [(inflow - math.sqrt(max(level, 0.0))) / TANK_AREA, (u - valve) / TANK_LAG_S]


def _tank_guess(y: float, _w: float) -> tuple[list[float], float]:
    valve = 100.0 * (1.0 + math.log(math.sqrt(y) / 10.0) / math.log(VALVE_RANGE))
    return [y, valve], valve


KW, K1, K2, CARBONATE, ACID, BASE = 1e-14, 4.47e-7, 5.62e-11, 3e-3, 5e-3, 0.02
VESSEL, STREAM, PROBE_S = 3.0, 0.02, 8.0  # Litres, litres a second, seconds


def charge(ph: float) -> float:
    """Strong base less strong acid, mol/l, that gives this pH with the carbonate in the stream."""
    h = 10.0**-ph
    bound = CARBONATE * (K1 / h + 2 * K1 * K2 / h**2) / (1 + K1 / h + K1 * K2 / h**2)
    return bound + KW / h - h


def _ph(x: State, u: float, _w: float) -> list[float]:
    strong, probe = x
    base = STREAM * max(u, 0.0) / 100.0
    # the pH at this charge: `charge` inverted by bisection
    low, high = 0.0, 14.0
    for _ in range(34):
        middle = (low + high) / 2
        low, high = (middle, high) if charge(middle) < strong else (low, middle)
    return [(STREAM * (-ACID - strong) + base * (BASE - strong)) / VESSEL, ((low + high) / 2 - probe) / PROBE_S]


def _ph_guess(y: float, _w: float) -> tuple[list[float], float]:
    strong = charge(y)
    return [strong, y], 100.0 * (strong + ACID) / (BASE - strong)


RATE, ACTIVATION, RISE, COOLING, JACKET_S, STAY_S, FEED = 1.2e9, 8000.0, 60.0, 0.06, 10.0, 60.0, 300.0


def _reactor(x: State, u: float, _w: float) -> list[float]:
    left, temp, jacket = x
    rate = RATE * math.exp(-ACTIVATION / temp) * left
    heat = (FEED - temp) / STAY_S + RISE * rate - COOLING * (temp - jacket)
    return [(1 - left) / STAY_S - rate, heat, (u - jacket) / JACKET_S]


def _reactor_guess(y: float, _w: float) -> tuple[list[float], float]:
    speed = RATE * math.exp(-ACTIVATION / y)
    left = 1 / (1 + speed * STAY_S)
    jacket = y - ((FEED - y) / STAY_S + RISE * speed * left) / COOLING
    return [left, y, jacket], jacket


HOLD_UP, COLD, PIPE, STEAM_S, THERMOMETER_S = 400.0, 20.0, 240.0, 4.0, 6.0


def _exchanger(x: State, u: float, w: float) -> list[float]:
    temp, steam, shown = x
    return [(w * (COLD - temp) + 60.0 * steam) / HOLD_UP, (u - steam) / STEAM_S, (temp - shown) / THERMOMETER_S]


def _exchanger_guess(y: float, w: float) -> tuple[list[float], float]:
    steam = w * (y - COLD) / 60.0
    return [y, steam, y], steam


BASE_SPEED, INERTIA, FRICTION, FAN, CURRENT_S = 50.0, 1.0, 0.25, 0.02, 0.05


def _drive(x: State, u: float, _w: float) -> list[float]:
    speed, current = x
    torque = 2.5 * current * min(1.0, BASE_SPEED / max(speed, 1.0))
    return [(torque - FRICTION * speed - FAN * speed * abs(speed)) / INERTIA, (u - current) / CURRENT_S]


def _drive_guess(y: float, _w: float) -> tuple[list[float], float]:
    current = (FRICTION * y + FAN * y * y) / (2.5 * min(1.0, BASE_SPEED / y))
    return [y, current], current


def from_equations(
    name: str,
    equations: Equations,
    low: float,
    high: float,
    noise: float,
    *,
    by: str = "pv",
    sp0: float = 0.0,
    kind: str = "physics",
    co: tuple[float, float] = (0.0, 100.0),
    span: float = 0.0,
) -> Subject:
    """A plant given by equations, as a subject."""
    inside = by == "pv"
    y: Callable[[float], float] = (lambda x: x) if inside else (lambda _: sp0)
    w: Callable[[float], float] = (lambda _: 0.0) if inside else (lambda x: x)
    dt_s = sampling(lambda x: equations.linear(y(x), w(x)), low, high)
    return Subject(
        name=name,
        kind=kind,
        low=low,
        high=high,
        by=by,
        dt_s=dt_s,
        noise=noise,
        span=span or high - low,
        live=lambda x: InMotion(equations, dt_s, y(x), w(x), inside=inside),
        rest=lambda x: equations.rest(y(x), w(x))[1],
        local=lambda x: equations.linear(y(x), w(x)),
        co_min=co[0],
        co_max=co[1],
        sp0=sp0,
    )


class _Oven:
    def __init__(self, settings: OvenSettings, dt_s: float, y: float) -> None:
        self._plant, self._dt_s = OvenPlant(settings, y), dt_s

    def move(self, co: float, _place: float) -> float:
        self._plant.step(min(max(co, 0.0), 100.0), 0.0, self._dt_s)
        return self._plant.pv


def _oven() -> Subject:
    settings = OvenSettings()
    plant = OvenPlant(settings)
    dt_s = sampling(plant.linearise, 40.0, 200.0)
    return Subject(
        name="oven",
        kind="physics",
        low=40.0,
        high=200.0,
        by="pv",
        dt_s=dt_s,
        noise=0.1,
        span=160.0,
        live=partial(_Oven, settings, dt_s),
        rest=plant.steady_co,
        local=plant.linearise,
        co_min=0.0,
        co_max=100.0,
    )


def _slow(seconds: float) -> Callable[[float, float], float]:
    return lambda _y, _w: seconds


MAKERS: dict[str, Callable[[], Subject]] = {
    "tank": lambda: from_equations("tank", Equations(_tank, lambda x: x[0], _tank_guess, _slow(4.0)), 8.0, 90.0, 0.1),
    "ph": lambda: from_equations("ph", Equations(_ph, lambda x: x[1], _ph_guess, _slow(6.0)), 5.5, 9.5, 0.01),
    "reactor": lambda: from_equations(
        "reactor",
        Equations(_reactor, lambda x: x[1], _reactor_guess, _slow(4.0)),
        305.0,
        375.0,
        0.07,
        co=(200.0, 500.0),
    ),
    "exchanger": lambda: from_equations(
        "exchanger",
        Equations(_exchanger, lambda x: x[2], _exchanger_guess, lambda _, w: PIPE / w),
        10.0,
        80.0,
        0.05,
        by="flow",
        sp0=60.0,
        span=40.0,
    ),
    "oven": _oven,
    "drive": lambda: from_equations(
        "drive", Equations(_drive, lambda x: x[0], _drive_guess, _slow(0.1)), 8.0, 95.0, 0.1, co=(0.0, 250.0)
    ),
}
