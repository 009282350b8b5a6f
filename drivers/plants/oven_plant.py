"""A laboratory oven: a plant whose gain, lag and delay all change with the temperature at which it works.

    C(T) dT/dt     = p(t - theta(T)) + load - loss(T)
    loss(T)        = h (T - Ta) + eps_a sigma (T_K^4 - Ta_K^4)            convection and radiation, T_K absolute
    C(T)           = C0 (1 + c (T - 20))
    p(co)          = P [(1 - w) x + w (x - sin(2 pi x)/(2 pi))], x = co/100   part burst firing, part phase angle
    theta(T)       = theta_cold (theta_hot/theta_cold)^((T - 20)/200)      the hotter, the faster the circulation
    tau_s dpv/dt   = T - pv                                               sensor in its pocket

The power passes a buffer of what was fired; a sample receives the mean of what lies between the two delayed instants,
which is exact for a held output and any delay, whole samples or not. (T, pv) are integrated by the classic
Runge-Kutta method with steps of at most MAX_STEP_S: with tau_s = 12 s its error is below 1e-5 of a move.
"""

import math
from bisect import bisect_right

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.plants.plant import MeasurementNoise, check_step
from retuner.schedule.late_dataclass import dataclass

STEFAN_BOLTZMANN = 5.670374419e-8  # W/(m^2 K^4), CODATA 2018
KELVIN = 273.15  # 0 degC
MAX_STEP_S = 2.0  # longest integration step
HISTORY_TRIM = 1024  # entries of the delay buffer after which the used ones are dropped
REFERENCE_C = 20.0  # temperature at which theta_cold_s and heat_capacity_j_k hold
SPAN_C = 200.0  # theta_hot_s holds this much above


@dataclass(frozen=True, slots=True)
class OvenSettings:
    """The oven's physics. Defaults: a 600 W oven of about 12 litres with a water-cooled jacket, 20 to 220 degC.

    The file's head has the symbols: w phase_share, Ta jacket_c, h convection_w_k, eps_a radiating_area_m2.

    Raises ValueError: a number is not finite or outside its physical range (named).
    """

    power_w: float = setting(600.0, "Heater power at 100 %", ">0..1e6 W", "plant")
    phase_share: float = setting(0.2, "Share of the power under phase-angle control", "0..0.9 1", "plant")
    jacket_c: float = setting(5.0, "Temperature of the cooled jacket", "-273.15..500 degC", "plant")
    convection_w_k: float = setting(1.2, "Heat lost by convection", ">0..1e4 W/K", "plant")
    radiating_area_m2: float = setting(0.08, "Emissivity times radiating area", "0..100 m2", "plant")
    heat_capacity_j_k: float = setting(380.0, "Heat capacity at 20 degC", ">0..1e8 J/K", "plant")
    capacity_growth_1_k: float = setting(0.005, "Growth of the heat capacity", "0..1 1/K", "plant")
    theta_cold_s: float = setting(45.0, "Transport delay at 20 degC", ">0..1e5 s", "plant")
    theta_hot_s: float = setting(12.0, "Transport delay at 220 degC", ">0..1e5 s", "plant")
    tau_sensor_s: float = setting(12.0, "Sensor lag", ">0..1e5 s", "plant")
    noise_c: float = setting(0.06, "Standard deviation of the measurement noise", "0..100 degC", "plant")

    def __post_init__(self) -> None:
        require_in_range(self, "oven")

    def power(self, co: float) -> float:
        """Heater power in W at co percent (held to 0..100)."""
        x = 0.0 if co < 0.0 else 1.0 if co > 100.0 else co / 100.0
        return self.power_w * (x - self.phase_share * math.sin(2 * math.pi * x) / (2 * math.pi))

    def loss(self, temp_c: float) -> float:
        """Heat lost in W at this chamber temperature."""
        kelvin, jacket = temp_c + KELVIN, self.jacket_c + KELVIN
        radiated = self.radiating_area_m2 * STEFAN_BOLTZMANN * (kelvin**4 - jacket**4)
        return self.convection_w_k * (temp_c - self.jacket_c) + radiated

    def capacity(self, temp_c: float) -> float:
        """Heat capacity in J/K."""
        return self.heat_capacity_j_k * (1 + self.capacity_growth_1_k * (temp_c - REFERENCE_C))

    def theta(self, temp_c: float) -> float:
        """Transport delay in s."""
        return self.theta_cold_s * math.pow(self.theta_hot_s / self.theta_cold_s, (temp_c - REFERENCE_C) / SPAN_C)


class OvenPlant:
    """The oven in motion. A load is in percent of full heater power and acts in the chamber without delay.

    settings : physics.
    start_c : temperature of chamber and sensor at the start, held by the matching co since ever.
    seed : of the measurement noise.

    Raises ValueError: no output holds the oven at start_c.
    """

    def __init__(self, settings: OvenSettings | None = None, start_c: float = 25.0, seed: int = 0) -> None:
        self.settings = settings or OvenSettings()
        self._noise = MeasurementNoise(self.settings.noise_c, seed)
        self._chamber = self.pv = start_c  # pv : of the sensor, without noise
        self._t_s = 0.0
        power = self.settings.power(self.steady_co(start_c))
        self._times, self._powers, self._fired = [0.0], [power], [0.0]  # since when, W, J fired until then
        self._read_to_s = -self.settings.theta(start_c)

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s and read the sensor: see plant.Plant."""
        check_step(co, load, dt_s)
        settings = self.settings
        fired = self._fired[-1] + self._powers[-1] * (self._t_s - self._times[-1])
        self._times.append(self._t_s)
        self._powers.append(settings.power(co))
        self._fired.append(fired)
        load_w = settings.power_w * load / 100.0
        n = math.ceil(dt_s / MAX_STEP_S)
        for _ in range(n):
            self._t_s += dt_s / n
            self._integrate(self._arriving() + load_w, dt_s / n)
        if len(self._times) > HISTORY_TRIM:
            used = max(bisect_right(self._times, self._read_to_s) - 1, 0)
            del self._times[:used], self._powers[:used], self._fired[:used]  # nothing reads them any more
        return self.pv + self._noise()

    def _arriving(self) -> float:
        """Mean power in W that reaches the chamber in the step that ends now."""
        start = self._read_to_s
        end = self._t_s - self.settings.theta(self._chamber)
        if end <= start:  # cooling so fast that the delay outruns time: the last packet stays
            return self._powers[max(bisect_right(self._times, start) - 1, 0)]
        self._read_to_s = end
        return (self._fired_until(end) - self._fired_until(start)) / (end - start)

    def _fired_until(self, t_s: float) -> float:
        """Energy in J fired until t_s (before the first entry the first power)."""
        i = max(bisect_right(self._times, t_s) - 1, 0)
        return self._fired[i] + self._powers[i] * (t_s - self._times[i])

    def _integrate(self, power_w: float, dt_s: float) -> None:
        """One Runge-Kutta step of (chamber, sensor) under constant power."""
        settings, t0, s0, lag = self.settings, self._chamber, self.pv, self.settings.tau_sensor_s
        half = dt_s / 2
        a1, b1 = (power_w - settings.loss(t0)) / settings.capacity(t0), (t0 - s0) / lag
        t, s = t0 + half * a1, s0 + half * b1
        a2, b2 = (power_w - settings.loss(t)) / settings.capacity(t), (t - s) / lag
        t, s = t0 + half * a2, s0 + half * b2
        a3, b3 = (power_w - settings.loss(t)) / settings.capacity(t), (t - s) / lag
        t, s = t0 + dt_s * a3, s0 + dt_s * b3
        a4, b4 = (power_w - settings.loss(t)) / settings.capacity(t), (t - s) / lag
        self._chamber = t0 + dt_s * (a1 + 2 * (a2 + a3) + a4) / 6
        self.pv = s0 + dt_s * (b1 + 2 * (b2 + b3) + b4) / 6

    def steady_co(self, pv: float, load: float = 0.0) -> float:
        """Output in percent that holds pv, by bisection of the rising power characteristic: see plant.Plant."""
        needed = self.settings.loss(pv) - self.settings.power_w * load / 100.0
        if not 0.0 <= needed <= self.settings.power_w:
            raise ValueError(f"{pv} degC needs {needed:.0f} W; the heater gives 0 to {self.settings.power_w} W")
        low, high = 0.0, 100.0
        for _ in range(60):  # 60 halvings: below the spacing of doubles
            middle = (low + high) / 2
            low, high = (middle, high) if self.settings.power(middle) < needed else (low, middle)
        return (low + high) / 2

    def linearise(self, pv: float, load: float = 0.0) -> LinearProcess:  # noqa: ARG002  it depends on temperature
        """Gain p'(co)/loss', lags C/loss' and the sensor's, theta at that temperature: see plant.Plant."""
        settings = self.settings
        x = self.steady_co(pv) / 100.0
        slope_w = settings.power_w * (1 - settings.phase_share * math.cos(2 * math.pi * x)) / 100.0
        loss = settings.convection_w_k + 4 * settings.radiating_area_m2 * STEFAN_BOLTZMANN * (pv + KELVIN) ** 3
        lags = (settings.capacity(pv) / loss, settings.tau_sensor_s)
        return LinearProcess(slope_w / loss, lags, (), settings.theta(pv))
