"""`retuner.simulate`: a loop of a process and a controller in simulated time, as a trend."""

import math
import random
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step
from retuner.simulation.loop_trend import History, LoopTrend

Course = float | Sequence[tuple[float, float]] | Callable[[float], float]
"""A number; pairs (from this second on, this value); or a function of the seconds."""


class Controller(Protocol):
    """Whatever takes setpoint and pv and gives the output."""

    def step(self, sp: float, pv: float, /) -> float:
        """Take one sample; the output to hold until the next one."""


@runtime_checkable
class Watched(Protocol):
    """A controller with a retuner, as PidController is: it takes a loop over without a bump."""

    @property
    def retuner(self) -> object:
        """What watches its loop."""

    def step(self, sp: float, pv: float, *, manual_co: float) -> float:
        """Take one sample, with the output that stands."""


Process = ProcessModel | LinearProcess | Callable[[float, float], float]
"""A model; or a function of co (loads included) and dt_s that moves a process by one sample and gives its pv."""
MOST_SAMPLES = 10_000_000  # samples of a simulation


def simulate(
    process: Process,
    controller: PidGains | Controller,
    *,
    setpoint: Course,
    loads: Course = 0.0,
    until_s: float,
    dt_s: float = 1.0,
    start_pv: float | None = None,
    start_co: float = 50.0,
    co_range: tuple[float, float] = (0.0, 100.0),
    noise: float = 0.0,
    seed: int = 0,
) -> LoopTrend:
    """Run a loop from rest.

    Parameters
    ----------
    process : a model, exact with its dead time; or a function (co, dt_s) -> pv.
    controller : gains, for a plain PID; a PidController; or anything with step(sp, pv) -> co.
    setpoint : a number, pairs such as [(0, 50), (600, 60)], or a function of the seconds; pv units.
    loads : the same, at the process input; co units. until_s, dt_s : length and sampling interval, seconds.
    start_pv, start_co : where the process stands at rest; start_pv is the first setpoint where not given.
    co_range : limits of the output, co units; a controller of your own keeps its own. noise : standard deviation of the
        sensor's noise, pv units; seed : of that noise.

    Returns
    -------
    LoopTrend

    Raises
    ------
    ValueError
        A number is not finite, a time is not positive, the process has more zeros than poles, or there are over ten
        million samples.

    Examples
    --------
    >>> model = ProcessModel("fopdt", k=2.0, tau1_s=30.0, theta_s=5.0)
    >>> trend = simulate(model, PidGains(1.5, 0.05), setpoint=[(0, 50), (60, 55)], until_s=300.0)
    >>> float(trend.pv[-1])
    55.0...
    """
    if not (0.0 < dt_s < math.inf and 0.0 < until_s < math.inf):
        raise ValueError(f"until_s = {until_s}, dt_s = {dt_s}: give positive finite numbers of seconds")
    count = round(until_s / dt_s)
    if count > MOST_SAMPLES:
        raise ValueError(f"until_s / dt_s = {count} samples are over {MOST_SAMPLES}; simulate less at once")
    wanted, load = _course("setpoint", setpoint), _course("loads", loads)
    pv0 = wanted(0.0) if start_pv is None else float(start_pv)
    move, gauss = _moves(process, pv0, start_co, dt_s), random.Random(seed).gauss  # noqa: S311  noise of a sensor
    stepped = _plain_pid(controller, co_range, start_co, dt_s) if isinstance(controller, PidGains) else controller.step
    history, pv, co_at = History(count), pv0, start_co
    for i in range(count):
        t_s = i * dt_s
        sp, seen = wanted(t_s), pv + (gauss(0.0, noise) if noise else 0.0)
        if i == 0 and isinstance(controller, Watched):
            co_at = controller.step(sp, seen, manual_co=start_co)
        else:
            co_at = stepped(sp, seen)
        history.add((t_s, sp, seen, co_at, *_gains_of(controller)))
        pv = float(move(co_at + load(t_s), dt_s))
        if not math.isfinite(pv):
            raise ValueError(f"pv = {pv} at {t_s + dt_s:g} s: the process gave no finite number")
    return history.trend()


def _course(name: str, given: Course) -> Callable[[float], float]:
    """A setpoint or load as a function of the seconds.

    Raises ValueError: a value is not finite, or times do not increase from 0 on.
    """
    if callable(given):
        return given
    pairs = [(0.0, given)] if isinstance(given, int | float) else [(float(t), float(value)) for t, value in given]
    times = [t for t, _ in pairs]
    if not pairs or times != sorted(set(times)) or not all(math.isfinite(x) for pair in pairs for x in pair):
        raise ValueError(f"{name} = {given!r}: give a number, or pairs (seconds, value) with increasing seconds")
    if times[0] > 0 and name == "setpoint":
        raise ValueError(f"{name} = {given!r}: say its value from 0 s on")

    def at(t_s: float) -> float:
        passed = [value for t, value in pairs if t <= t_s]
        return float(passed[-1]) if passed else 0.0

    return at


def _moves(process: Process, pv0: float, co0: float, dt_s: float) -> Callable[[float, float], float]:
    if not isinstance(process, ProcessModel | LinearProcess):
        return process
    plant = HeldInput(process.linear() if isinstance(process, ProcessModel) else process, dt_s)
    return lambda co, _: pv0 + plant.step(co - co0)


def _plain_pid(
    gains: PidGains, co_range: tuple[float, float], co0: float, dt_s: float
) -> Callable[[float, float], float]:
    """A PID with these gains, at rest at co0 in its first sample; its derivative has a filter."""
    pid = law(gains, tau_f_s=gains.kd / gains.kp / 10.0 if gains.kp else 0.0, co_min=co_range[0], co_max=co_range[1])
    states: list[tuple[float, float, float, float, int]] = []

    def stepped(sp: float, pv: float) -> float:
        after, co = step(pid, states.pop() if states else start(pid, sp, pv, co0), sp, pv, dt_s)
        states.append(after)
        return co

    return stepped


def _gains_of(controller: object) -> tuple[float, float, float]:
    gains = controller if isinstance(controller, PidGains) else getattr(controller, "gains", None)
    return (gains.kp, gains.ki, gains.kd) if isinstance(gains, PidGains) else (math.nan, math.nan, math.nan)
