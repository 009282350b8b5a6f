"""Processes of the world with real loads, their exact margins, and the loop simulated a quarter of a sample at a time.

Times are in samples. The margins count half a sample for the hold. Nothing here is the library's: truth is told apart.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
FREQUENCIES = np.logspace(-4.5, math.log10(3.0), 1500)
PARTS = 4  # Of a sample, in the simulation


@dataclass(frozen=True, slots=True)
class TrueProcess:
    """kind : of its structure. k : gain, or slope gain. lags, theta : in samples. integrates : has an integrator.

    bend : share of itself by which the gain grows a unit of pv, from pv = 0 where it is k; 0 for a linear process.
    """

    kind: str
    k: float
    lags: tuple[float, ...]
    theta: float
    integrates: bool
    bend: float = 0.0

    def response(self, w: FloatArray) -> npt.NDArray[np.complex128]:
        """G(jw) with the hold."""
        s = 1j * w
        g = self.k * np.exp(-s * (self.theta + 0.5))
        if self.integrates:
            g = g / s
        for lag in self.lags:
            g = g / (lag * s + 1.0)
        return np.asarray(g, dtype=np.complex128)


AWAY = 1e12  # A loop whose pv is farther away has run away
LEAST_GAIN = 0.1  # A process that bends keeps this share of its gain everywhere


def bent(x: float, bend: float) -> float:
    """A static curve whose slope is 1 + bend y at the output y, LEAST_GAIN at least."""
    edge = math.log(LEAST_GAIN) / bend  # where the slope has fallen to LEAST_GAIN
    if bend * x < math.log(LEAST_GAIN):
        return (LEAST_GAIN - 1.0) / bend + LEAST_GAIN * (x - edge)
    return math.expm1(min(bend * x, 50.0)) / bend


def margins(process: TrueProcess, kc: float, tau_i: float) -> tuple[float, float]:
    """Ms (infinite where unstable) and gain margin with a PI controller."""
    loop = process.response(FREQUENCIES) * kc * (1.0 + 1.0 / (1j * FREQUENCIES * tau_i))
    phase = np.unwrap(np.angle(loop))
    falls = np.flatnonzero((phase[:-1] > -math.pi) & (phase[1:] <= -math.pi))
    gain_margin = 1.0 / float(np.max(np.abs(loop[falls]))) if len(falls) else math.inf
    peak = float(np.max(1.0 / np.abs(1.0 + loop)))
    return (math.inf if gain_margin <= 1.0 or phase[0] <= -math.pi else peak), gain_margin


def drawn_process(rng: np.random.Generator) -> TrueProcess:
    """One lag, two lags, integrating, integrating with a lag, or higher order; dead time 0.6 to 12 samples."""
    kind = str(rng.choice(["one lag", "two lags", "integrating", "integrating lag", "higher order"]))
    theta, lag = (math.exp(rng.uniform(math.log(low), math.log(high))) for low, high in ((0.6, 12.0), (2.0, 60.0)))
    k = math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
    integrates = kind.startswith("integrating")
    if integrates:
        k /= math.exp(rng.uniform(math.log(10.0), math.log(100.0)))
    lags = {
        "one lag": (lag,),
        "two lags": (lag, lag * rng.uniform(0.2, 0.8)),
        "integrating": (),
        "integrating lag": (min(lag, 20.0) * rng.uniform(0.2, 1.0),),
        "higher order": (lag / 3,) * int(rng.integers(3, 5)),
    }[kind]
    return TrueProcess(kind, k, lags, theta, integrates)


def simc(process: TrueProcess) -> tuple[float, float]:
    """SIMC's kc and tau_i by the half rule (Skogestad 2003), where the search for settings begins."""
    if process.integrates:
        span = process.theta + 0.5 + sum(process.lags)
        return 0.5 / (process.k * span), 8 * span
    lags = sorted(process.lags, reverse=True)
    first, theta = lags[0], process.theta + 0.5
    if len(lags) > 1:
        first, theta = first + lags[1] / 2, theta + lags[1] / 2 + sum(lags[2:])
    return 0.5 * first / (process.k * theta), min(first, 8 * theta)


def simulated(
    process: TrueProcess,
    gains: tuple[float, float],
    signals: tuple[FloatArray, FloatArray, FloatArray],
    band: float = 0.0,
    steps: tuple[float, float] = (0.0, 0.0),
    *,
    manual: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """pv and co of the loop; nan where it runs away.

    gains : kc and tau_i. signals : setpoint, load at the process input, noise. band : a valve stays where it is until
    co is farther from it than this. steps : of the recorded pv and co (quantised), 0 for none. manual : co is what
    stands in the place of the setpoint.
    """
    kc, tau_i = gains
    setpoint, load, noise = signals
    n, h = len(setpoint), 1.0 / PARTS
    state = [0.0] * (len(process.lags) + 1)
    decays = [math.exp(-h / lag) for lag in process.lags]
    whole, part = int(process.theta / h), process.theta / h - int(process.theta / h)
    late = [0.0] * (whole + 2)
    total = valve = y = 0.0
    pv, co, at = np.zeros(n), np.zeros(n), 0
    for t in range(n):
        if not abs(y) < AWAY:
            return np.full(n, math.nan), np.full(n, math.nan)
        measured = y + noise[t]
        measured = round(measured / steps[0]) * steps[0] if steps[0] else measured
        total += kc / tau_i * (setpoint[t] - measured)
        output = setpoint[t] if manual else kc * (setpoint[t] - measured) + total
        output = round(output / steps[1]) * steps[1] if steps[1] else output
        pv[t], co[t] = measured, output
        valve = output if abs(output - valve) > band else valve
        for _ in range(PARTS):
            late[at % len(late)] = valve + load[t]
            moved = late[(at - whole) % len(late)] * (1 - part) + late[(at - whole - 1) % len(late)] * part
            at += 1
            x = process.k * moved
            if process.integrates:
                state[-1] += h * x * max(1.0 + process.bend * state[-1], LEAST_GAIN)
                x = state[-1]
            for j, decay in enumerate(decays):
                state[j] = x = decay * state[j] + (1 - decay) * x
            y = x if process.integrates or not process.bend else bent(x, process.bend)
    return pv, co
