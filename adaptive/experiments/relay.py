"""Relay feedback: ultimate gain and period from the half-waves of a limit cycle (Astrom & Hagglund 1984).

    Ku = 4 d / (pi a)                        ideal relay of amplitude d, a the amplitude of pv
    Ku = 4 d / (pi sqrt(a^2 - eps^2))        with hysteresis eps
    Pu = mean duration of a full wave

The formulas take the wave for a sine (describing function): Ku is right within a few per cent for several lags, and
20 % too low for first order or an integrator with dead time. A full wave begins at every switching, and each gives one
Ku and one Pu. Reported is the mean with the standard deviation over the waves, which says what noise, drift and coarse
sampling did. Left out are the first wave, waves that last less than half or more than twice the median (a setpoint
change), and outliers of the rest by their median absolute deviation (the limit cycle has not been reached). Noisy peaks
are read off a smoothed record.

The frequency response at the fundamental, G(jw) = Y1/U1 by Fourier over whole waves, needs no sine wave. Its phase
would be -180 degrees for an ideal relay: what is missing is hysteresis, and the time that passes between pv's crossing
and co's switching.
"""

import cmath
import math

import numpy as np

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median, trapezoid
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values

FEWEST_WAVES = 2  # full waves from which a result is given; the first after the start is not among them
LEVEL_WIDTH = 0.05  # co within this share of the relay's range belongs to one of its two levels
OFF_LEVEL = 0.02  # share of samples (after the first switching) that may be at neither level
ODD_WAVE = 2.0  # waves that differ from the median by more than this factor in duration are not of the limit cycle
SHORT_HALF = 20.0  # A half-wave shorter than this part of a wave is noise at the switching point
OUTLIER, MAD_TO_SIGMA = 3.0, 1.4826
"""Waves further from the median than this many standard deviations, estimated robustly, are left out."""
SMOOTHED_SHARE, NOISE_LEFT = 20.0, 0.03
"""pv is smoothed over at most this part of a wave, until this share of its height is left of the noise."""
NEXT_TO_HYSTERESIS = 1.05
"""An amplitude within this factor of the hysteresis says nothing: the root in Ku's formula vanishes."""


@dataclass(frozen=True, slots=True)
class RelayCycle:
    """A relay's limit cycle.

    ku, pu_s : ultimate gain in co per pv (positive) and period in s. ku_std, pu_std_s : standard deviation over the
        waves. waves : how many full waves count.
    amplitude, co_amplitude : half the height of pv's wave and of the relay's. hysteresis : as given, pv units.
    high_s, low_s : mean duration of the relay's upper and lower half-wave.
    pv_high, pv_low : mean of the waves' largest and smallest pv. pv_mean, co_mean : means over whole waves.
    co_high, co_low : the relay's levels. from_s, to_s : time of the waves that count.
    gain, phase_deg : of the process at the fundamental, G(j 2 pi/Pu); phase in -360..0.
    """

    ku: float
    pu_s: float
    ku_std: float
    pu_std_s: float
    waves: int
    amplitude: float
    co_amplitude: float
    hysteresis: float
    high_s: float
    low_s: float
    pv_high: float
    pv_low: float
    pv_mean: float
    co_mean: float
    co_high: float
    co_low: float
    from_s: float
    to_s: float
    gain: float
    phase_deg: float

    @property
    def direction(self) -> int:
        """Sign of the process gain: a relay of the right sign swings where the phase is nearer to -180 than to 0."""
        return 1 if -270 < self.phase_deg < -90 else -1

    def to_dict(self) -> dict[str, float | int | bool]:
        """Keys as in the JSON output of `retuner experiment relay`."""
        names = "ku pu=pu_s ku_std pu_std=pu_std_s waves amplitude co_amplitude hysteresis high=high_s low=low_s gain"
        return plain_values(self, f"{names} phase_deg")


def relay_cycle(window: Window, hysteresis: float = 0.0) -> RelayCycle:
    """Evaluate a record of relay feedback.

    window : the record; what comes before the first switching, and odd waves, are left out.
    hysteresis : of the relay on either side of its reference, pv units.

    Raises ValueError: co is not a relay's, it switches too rarely, the hysteresis is negative, or the waves do not rise
    above it.
    """
    if not (math.isfinite(hysteresis) and hysteresis >= 0):
        raise ValueError(f"hysteresis = {hysteresis}: give 0 or a positive number of pv units")
    upper = _levels(window.co)
    # First and last sample of each full wave of usual duration
    switches = np.flatnonzero(np.diff(upper.astype(np.int8))) + 1
    if len(switches) < 2 * FEWEST_WAVES + 2:
        raise ValueError(
            f"the relay switches {len(switches)} times, {2 * FEWEST_WAVES + 2} are needed at least: "
            "record longer, or see whether its sign and size let pv cross the reference"
        )
    # indices into switches at which a full wave of usual duration begins, without the first half-wave
    times = window.t_s[switches]
    halves = np.diff(times)
    middle = median(halves[1:] + halves[:-1])
    kept = []
    for i in range(1, len(switches) - 2):
        usual = all(h > middle / SHORT_HALF for h in halves[i : i + 2])
        wave = float(times[i + 2] - times[i])
        if usual and middle / ODD_WAVE < wave < middle * ODD_WAVE:
            kept.append(i)
    if len(kept) < FEWEST_WAVES:
        raise ValueError("no two waves of the relay are alike; not a limit cycle yet: record longer")
    spans, periods, highs, lows = _waves(window, [(int(switches[i]), int(switches[i + 2])) for i in kept], hysteresis)
    amplitudes = (highs - lows) / 2
    amplitude = float(np.mean(amplitudes))
    co_high, co_low = median(window.co[upper]), median(window.co[~upper])
    d = (co_high - co_low) / 2
    point = _fundamental(window, spans)
    # mean durations of the upper and of the lower half-wave
    found: dict[bool, list[float]] = {True: [], False: []}
    for a, b in spans:
        first = bool(upper[a])
        switch = a + int(np.argmax(upper[a:b] != first))
        found[first].append(float(window.t_s[switch] - window.t_s[a]))
        found[not first].append(float(window.t_s[b] - window.t_s[switch]))
    high_s, low_s = float(np.mean(found[True])), float(np.mean(found[False]))
    # pv and co averaged over time, wave by wave
    held = np.diff(window.t_s)
    pv_mean, co_mean = (
        float(np.mean([float(x[a:b] @ held[a:b] / np.sum(held[a:b])) for a, b in spans]))
        for x in ((window.pv + np.roll(window.pv, -1)) / 2, window.co)
    )
    # Ultimate gain by the describing function: relay of amplitude d, waves of amplitude a
    return RelayCycle(
        ku=4 * d / (math.pi * math.sqrt(amplitude * amplitude - hysteresis * hysteresis)),
        pu_s=float(np.mean(periods)),
        ku_std=float(np.std(4 * d / (math.pi * np.sqrt(amplitudes**2 - hysteresis**2)))),
        pu_std_s=float(np.std(periods)),
        waves=len(spans),
        amplitude=amplitude,
        co_amplitude=d,
        hysteresis=hysteresis,
        high_s=high_s,
        low_s=low_s,
        pv_high=float(np.mean(highs)),
        pv_low=float(np.mean(lows)),
        pv_mean=pv_mean,
        co_mean=co_mean,
        co_high=co_high,
        co_low=co_low,
        from_s=float(window.t_s[spans[0][0]]),
        to_s=float(window.t_s[spans[-1][1]]),
        gain=abs(point),
        phase_deg=math.degrees(cmath.phase(point)) % 360 - 360,
    )


def _waves(
    window: Window, spans: list[tuple[int, int]], hysteresis: float
) -> tuple[list[tuple[int, int]], FloatArray, FloatArray, FloatArray]:
    """Spans of the waves without outliers, their durations in s, largest and smallest pv; each must rise above the
    hysteresis.
    """
    t, dt = window.t_s, window.sample_time_s
    periods = np.array([t[b] - t[a] for a, b in spans])
    # pv is smoothed over so few samples that a sine's peak loses less than half a per cent
    low, high = (float(x) for x in np.quantile(window.pv, (0.05, 0.95)))
    most = int(median(periods) / dt / SMOOTHED_SHARE) // 2 * 2 + 1
    sigma = noise_sigma(window.pv)
    wanted = (sigma / (NOISE_LEFT * max(high - low, sigma))) ** 2 if sigma else 0.0
    n = min(int(wanted) // 2 * 2 + 1, most)
    pv = window.pv
    if n >= 3:
        padded = np.concatenate([np.full(n // 2, window.pv[0]), window.pv, np.full(n // 2, window.pv[-1])])
        pv = np.convolve(padded, np.full(n, 1 / n), mode="valid")
    highs = np.array([float(np.max(pv[a:b])) for a, b in spans])
    lows = np.array([float(np.min(pv[a:b])) for a, b in spans])
    steps = np.abs(np.diff(window.pv))
    quantum = float(np.min(steps[steps > 0], initial=np.inf))
    usual = _near_median(periods, dt) & _near_median(highs - lows, min(2 * quantum, median(highs - lows)))
    spans = [span for span, kept in zip(spans, usual, strict=True) if kept]
    highs, lows = highs[usual], lows[usual]
    amplitudes = (highs - lows) / 2
    if np.min(amplitudes) <= hysteresis * NEXT_TO_HYSTERESIS:
        raise ValueError(
            f"the waves of pv are {float(np.mean(amplitudes)):.3g} high on either side, no more than the hysteresis of "
            f"{hysteresis:.3g}; raise the relay's amplitude or lower its hysteresis"
        )
    return spans, periods[usual], highs, lows


def _near_median(values: FloatArray, slack: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which values are no outliers; slack is what rounding may move a value by."""
    off = np.abs(values - median(values))
    spread = max(MAD_TO_SIGMA * median(off), 0.01 * median(np.abs(values)))
    return np.asarray(off <= OUTLIER * spread + slack)


def _levels(co: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether the relay stands at its upper level, for each sample; before it begins, at neither, counts as lower."""
    low, high = float(np.min(co)), float(np.max(co))
    if high == low:
        raise ValueError(f"co stays at {low:g}: the relay never switched")
    width = LEVEL_WIDTH * (high - low)
    at_level = (co >= high - width) | (co <= low + width)
    first = int(np.argmax(at_level))
    off = float(np.mean(~at_level[first:]))
    if off > OFF_LEVEL:
        raise ValueError(
            f"co is between its levels {low:g} and {high:g} in {off:.0%} of the samples; this is not what "
            "a relay puts out"
        )
    return np.asarray(co > (low + high) / 2)


def _fundamental(window: Window, waves: list[tuple[int, int]]) -> complex:
    """G(jw) from the fundamentals of pv and co, the mean over the waves; co is held between samples."""
    ratios = []
    for a, b in waves:
        t, end = window.t_s[a:b], float(window.t_s[b])
        w = 2 * math.pi / (end - float(t[0]))
        edges = np.append(t, end)
        turns = np.exp(-1j * w * edges)
        u1 = np.sum(window.co[a:b] * np.diff(turns)) / (-1j * w)
        pv = window.pv[a : b + 1] - float(np.mean(window.pv[a:b]))
        y1 = trapezoid(pv * turns, edges)
        ratios.append(y1 / u1)
    return complex(np.mean(ratios))


# First order + dead time from an asymmetric relay: exact, not by the describing function (Wang, Hang & Zou 1997).
#
# About the rest point (the relay's reference, and the co that holds it) with levels u+ > 0 > u-, hysteresis eps and
# h = k u+, l = k u-, the limit cycle of k e^(-theta s)/(tau s + 1) has
#     largest pv    A+ = h + (eps - h) e^(-theta/tau)            smallest pv   A- = l - (eps + l) e^(-theta/tau)
#     upper half    t+ = theta + tau ln((h - A-)/(h - eps))      lower half    t- = theta + tau ln((A+ - l)/(-eps - l))
# and its mean gives the gain: k = mean(pv)/mean(co), both over whole waves from the rest point. So
#     e^(-theta/tau) = ((h - A+) + (A- - l)) / ((h - eps) + (-eps - l)),  tau = (t+ + t-)/(2 theta/tau + both
# logarithms) The mean of co must be off the rest point, hence the asymmetry. theta includes the delay of the switching
# itself.


SMALLEST_OFFSET = 0.03  # the mean of co must be this share of the relay's amplitude away from rest for k to be known


def first_order(cycle: RelayCycle, pv_rest: float, co_rest: float) -> ProcessModel:
    """The model behind a biased relay's limit cycle.

    cycle : as read off the record. pv_rest : the relay's reference, where pv rested under co_rest.

    Raises ValueError: the relay is symmetric, or the wave is not one of a first-order process at rest there.
    """
    co, pv = cycle.co_mean - co_rest, cycle.pv_mean - pv_rest
    if abs(co) < SMALLEST_OFFSET * cycle.co_amplitude:
        raise ValueError(
            f"the mean of co is only {co:.3g} off the rest point, which gives no process gain; use the fit "
            "(the relay is symmetric, or the process nearly integrating)"
        )
    k = pv / co
    sign = math.copysign(1.0, k)
    high, low = sorted((sign * (cycle.pv_high - pv_rest), sign * (cycle.pv_low - pv_rest)), reverse=True)
    h, low_end = abs(k) * (cycle.co_high - co_rest), abs(k) * (cycle.co_low - co_rest)
    eps = cycle.hysteresis
    share = ((h - high) + (low - low_end)) / ((h - eps) + (-eps - low_end))
    if not (0 < share < 1 and h > max(high, eps) and low_end < min(low, -eps)):
        raise ValueError(
            "the process is not first order with dead time, by this limit cycle (integrating, or several lags): "
            "use the fit"
        )
    theta_ratio = -math.log(share)
    rise, fall = math.log((h - low) / (h - eps)), math.log((high - low_end) / (-eps - low_end))
    tau = (cycle.high_s + cycle.low_s) / (2 * theta_ratio + rise + fall)
    return ProcessModel(ProcessType.FOPDT, k, tau, 0.0, theta_ratio * tau)
