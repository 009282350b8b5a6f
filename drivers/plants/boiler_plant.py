"""A continuous-flow boiler: gain by temperature, lag and delay by flow; the test of a table along two variables.

    M c dT/dt   = P(co) - w c (T - T_in)                tank, perfectly mixed; w flow
    P(co)       = P_max (R^x - 1)/(R - 1), x = co/100   fuel valve of equal percentage, R its rangeability
    T_pipe(t)   = T(t'),  integral of w from t' to t = V   plug flow through the pipe to the sensor: theta = V/w
    tau_s dpv/dt = T_pipe - pv                          sensor in its pocket

Flow is in units of its nominal value: w = 1 + load/100, so that "load" is the change of flow in percent. A steady
state has P = w c (T - T_in): the gain P'(co)/(w c) = ln R/100 (T - T_in + P_max/((R - 1) w c)) rises with temperature,
the lag M/w and the delay V/w fall with flow. Step by step everything is exact for held co and load, but the sensor,
which takes the pipe's temperature in the middle of steps of at most MAX_STEP_S. Equal-percentage valve: F. G. Shinskey,
Process Control Systems, section 2.
"""

import math
from bisect import bisect_right

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.plants.plant import MeasurementNoise, check_step
from retuner.schedule.late_dataclass import dataclass

MAX_STEP_S = 0.5  # longest step of the sensor; with tau_s = 4 s its error is below 1e-3 of a move
HISTORY_TRIM = 4096  # entries of the pipe's contents after which those that have left it are dropped
LEAST_FLOW = 0.05  # share of the nominal flow that always runs


@dataclass(frozen=True, slots=True)
class BoilerSettings:
    """The boiler's physics, in units of the nominal flow's heat capacity rate w c.

    Raises ValueError: a number is not finite or outside its physical range (named).
    """

    inlet_c: float = setting(10.0, "Temperature of the water that comes in", "-50..500 degC", "plant")
    power_max_c: float = setting(160.0, "How much full power heats the nominal flow", ">0..1e4 K", "plant")
    rangeability: float = setting(20.0, "Rangeability of the fuel valve (equal percentage)", "1.001..1000 1", "plant")
    tank_s: float = setting(40.0, "Lag of the tank at nominal flow", ">0..1e5 s", "plant")
    pipe_s: float = setting(8.0, "Delay of the pipe at nominal flow", ">0..1e5 s", "plant")
    tau_sensor_s: float = setting(4.0, "Sensor lag", ">0..1e5 s", "plant")
    noise_c: float = setting(0.1, "Standard deviation of the measurement noise", "0..100 degC", "plant")
    flow_noise_pct: float = setting(
        0.5,
        "Standard deviation of the measured flow's noise, which the device publishes as PLANT.aux",
        "0..100 %",
        "plant",
    )

    def __post_init__(self) -> None:
        require_in_range(self, "boiler")

    def power(self, co: float) -> float:
        """Power in K of nominal flow at co percent (held to 0..100)."""
        x = min(max(co, 0.0), 100.0) / 100.0
        return self.power_max_c * (math.pow(self.rangeability, x) - 1.0) / (self.rangeability - 1.0)


def flow_of(load: float) -> float:
    """Flow in units of the nominal one under a load in percent."""
    return max(1.0 + load / 100.0, LEAST_FLOW)


class BoilerPlant:
    """The boiler in motion. A load is the change of the flow in percent of its nominal value.

    settings : physics. start_c : temperature everywhere at the start, at nominal flow. seed : of both noises.

    Raises ValueError: no output holds the boiler at start_c.
    """

    def __init__(self, settings: BoilerSettings | None = None, start_c: float = 30.0, seed: int = 0) -> None:
        self.settings = settings or BoilerSettings()
        self._noise = MeasurementNoise(self.settings.noise_c, seed)
        self._flow_noise = MeasurementNoise(self.settings.flow_noise_pct, seed + 1)
        self.steady_co(start_c)
        self._tank = self.pv = start_c  # pv : of the sensor, without noise
        self._passed = 0.0  # nominal pipe seconds of water that have left the tank
        self._marks, self._temps = [0.0], [start_c]
        self.aux = 100.0  # measured flow in percent of the nominal flow, noise included: of the last step

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s and read the sensor: see plant.Plant."""
        check_step(co, load, dt_s)
        settings, flow = self.settings, flow_of(load)
        goal = settings.inlet_c + settings.power(co) / flow
        n = math.ceil(dt_s / MAX_STEP_S)
        h = dt_s / n
        kept, held = math.exp(-flow * h / settings.tank_s), math.exp(-h / settings.tau_sensor_s)
        for _ in range(n):
            start = self._passed
            self._tank = goal + (self._tank - goal) * kept
            self._passed = start + flow * h
            self._marks.append(self._passed)
            self._temps.append(self._tank)
            # Temperature of the water that left the tank at a mark; before the first one the first temperature.
            mark = (start + self._passed) / 2 - settings.pipe_s
            i = bisect_right(self._marks, mark)
            if i == 0:
                arriving = self._temps[0]
            elif i == len(self._marks):
                arriving = self._temps[-1]
            else:
                w = (mark - self._marks[i - 1]) / (self._marks[i] - self._marks[i - 1])
                arriving = (1.0 - w) * self._temps[i - 1] + w * self._temps[i]
            self.pv = arriving + (self.pv - arriving) * held
        if len(self._marks) > HISTORY_TRIM:
            used = max(bisect_right(self._marks, self._passed - self.settings.pipe_s) - 2, 0)
            del self._marks[:used], self._temps[:used]  # the water that has passed the sensor
        self.aux = 100.0 * flow + self._flow_noise()
        return self.pv + self._noise()

    def steady_co(self, pv: float, load: float = 0.0) -> float:
        """Output in percent that holds pv: see plant.Plant."""
        settings = self.settings
        needed = flow_of(load) * (pv - settings.inlet_c)
        if not 0.0 <= needed <= settings.power_max_c:
            raise ValueError(
                f"{pv} degC needs {needed:.0f} K of nominal flow; the burner gives 0 to {settings.power_max_c:g} K"
            )
        ratio = settings.rangeability
        return 100.0 * math.log1p(needed / settings.power_max_c * (ratio - 1.0)) / math.log(ratio)

    def linearise(self, pv: float, load: float = 0.0) -> LinearProcess:
        """Gain P'(co)/w, lags of tank and sensor, delay of the pipe at this temperature and flow: see plant.Plant."""
        settings, flow = self.settings, flow_of(load)
        slope = math.log(settings.rangeability) / 100.0
        gain = slope * (pv - settings.inlet_c + settings.power_max_c / ((settings.rangeability - 1.0) * flow))
        return LinearProcess(gain, (settings.tank_s / flow, settings.tau_sensor_s), (), settings.pipe_s / flow)
