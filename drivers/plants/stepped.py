"""The linear model of somebody else's plant where a loop has worked, from small steps on a copy of it.

Nobody has the equations of an FMU or of a Python class, but a copy of it can be held where the run came to rest, and
its output stepped by a percent, or by more where that is lost in rounding: without noise and loads, the identification
of a test in manual finds the process. Other loops on the same plant stand still meanwhile: the loop by itself.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np

from retuner.adaptive.identification.identify import OPEN_LOOP, identify_window
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.drivers.plants.foreign_model import PlantFaultError
from retuner.drivers.plants.shared_plant import GOES_ON, PlantPort

STEPS_PCT = (1.0, 5.0, 20.0)
"""Sizes of the step of co that are tried: small against its range, large against rounding and a coarse sensor."""
CHUNK, MOST_CHUNKS = 40, 100  # samples after which it is looked whether pv still moves, and how often at the most
STILL = 0.0005  # share of its whole move that a pv at rest moves in a chunk at the most
LEAD = 20  # samples at rest before the step
FEWEST_AT_SETPOINT = 20  # samples at a setpoint, the last quarter of which shows the co that holds it
MOST_RESTS = 5
EXPLAINED = 0.02  # What the model may leave of the step response, as a share of its size


class NoProcessError(PlantFaultError):
    """A copy went on, and its step tells no process."""


def rests_of(sp: FloatArray, co: FloatArray) -> dict[float, float]:
    """The co that held each setpoint at the end of its time, by setpoint; MOST_RESTS of them at the most."""
    edges = [0, *(np.flatnonzero(np.diff(sp)) + 1).tolist(), len(sp)]
    found: dict[float, float] = {}
    for start, end in pairwise(edges):
        if end - start >= FEWEST_AT_SETPOINT:
            found[float(sp[start])] = float(np.mean(co[end - (end - start) // 4 : end]))
    if len(found) <= MOST_RESTS:
        return found
    kept = np.linspace(0, len(found) - 1, MOST_RESTS).round().astype(int).tolist()
    order = sorted(found)
    return {order[i]: found[order[i]] for i in kept}


class SteppedPlant:
    """What a run's scores ask of a plant (plant.KnownPlant.linearise).

    begin : a copy of the plant at its start, and how to end it. rests : co in percent by pv, see rests_of.
    sample_time_s : of the loop.
    """

    def __init__(
        self,
        begin: Callable[[], tuple[PlantPort, Callable[[], None]]],
        rests: Mapping[float, float],
        sample_time_s: float,
    ) -> None:
        self._begin, self._rests, self._dt_s = begin, rests, sample_time_s
        self._known: dict[float, LinearProcess] = {}

    def linearise(self, pv: float, load: float = 0.0) -> LinearProcess:  # noqa: ARG002  a load moves co alone
        """The process at the rest nearest to a pv.

        Raises PlantFaultError: the copy does not go on, or its response is that of no process that identification
        knows.
        """
        at = min(self._rests, key=lambda rest: abs(rest - pv))
        if at not in self._known:
            for size in STEPS_PCT:
                try:
                    self._known[at] = self._stepped(self._rests[at], size)
                    break
                except NoProcessError:
                    if size == STEPS_PCT[-1]:
                        raise
        return self._known[at]

    def _stepped(self, co: float, size: float) -> LinearProcess:
        port, end = self._begin()
        try:
            if not _held(port, co, self._dt_s)[1]:  # it integrates, or is too slow to wait for: from its start then
                end()
                port, end = self._begin()
                co = port.settings.start_co
            lead = [port.step(co, 0.0, self._dt_s) for _ in range(LEAD)]
            step = -size if co > 50.0 else size
            moved, _ = _held(port, co + step, self._dt_s)
        finally:
            end()
        if port.plant.fault:
            raise PlantFaultError(port.plant.fault.removesuffix(f"; {GOES_ON}"))
        pv = np.array([*lead, *moved], dtype=np.float64)
        given = np.full(len(pv), co, dtype=np.float64)
        given[LEAD - 1 :] += step  # held from the last sample of the lead on
        try:
            window = Window(np.arange(float(len(pv))) * self._dt_s, np.full(len(pv), pv[0]), pv, given)
            sign = 1 if (pv[-1] - pv[0]) * step >= 0.0 else -1  # else a tail with no gain explains a slow rise
            found = identify_window(window, sign, settings=OPEN_LOOP)
        except ValueError as error:
            raise NoProcessError(f"a step of its copy tells no process: {error}") from None
        if found.residual_std > EXPLAINED * float(np.ptp(pv)):  # gains are not asked for: a dead time may be open
            raise NoProcessError("a step of its copy is that of no process of second order")
        return found.log.model().linear()


def _held(port: PlantPort, co: float, dt_s: float) -> tuple[list[float], bool]:
    """Readings until pv is still, or for as long as anybody waits; and whether it is."""
    found = [port.pv]
    for _ in range(MOST_CHUNKS):
        found += [port.step(co, 0.0, dt_s) for _ in range(CHUNK)]
        if abs(found[-1] - found[-1 - CHUNK]) <= STILL * float(np.ptp(found)):
            return found[1:], True
    return found[1:], False
