"""All indexes of a record in one pass: numbers by name for the evidence of a diagnosis.

The period comes first (auto-covariance of the control error, else of co); everything that looks at shapes is measured
in it. What does not apply to a record is left out. glossary.py says what each name means.

Shape of the curve that pv draws over co: an ellipse in a linear oscillation, a parallelogram with a sticking valve.

Yamashita (2006) reads both signals as rising, steady or falling in each sample. With a sticking valve pv stands while
co moves (IS, DS; the first letter is co's) and then moves on:

    rho1 = (t_IS + t_DS) / (t_all - t_SS)
    rho3 = rho1 - (t_ISDD + t_ISDI + t_ISSD + t_ISID + t_DSDI + t_DSSI + t_DSID + t_DSII) / (t_all - t_SS)

rho3 leaves out standing samples that are followed by a movement that no valve would make. By chance rho1 is 0.25; well
above it they speak for a sticking valve of a flow loop, where pv is the valve's flow. Increments count as steady within
0.43 of their standard deviation, so noise rises, stands and falls equally often.

Ellipse (Choudhury, Shah & Thornhill 2008, section 8.3): with correlation c of pv and co the ellipse of their covariance
is 2 sqrt(2) std(co) sqrt(1 - c^2) wide along co: about the stick band when the valve is what makes the curve.
`roundness` is half the standard deviation of the whitened squared radius: 0 on an ellipse, 0.22 to 0.45 on a
parallelogram (even speed along its sides, or one signal a square wave), 1 for Gaussian noise.
"""

import math
from types import MappingProxyType

import numpy as np

from retuner.adaptive.indexes.autocovariance import (
    crossings,
    decay_ratio,
    detrended,
    iae_detection,
    regularity,
    running_mean,
)
from retuner.adaptive.indexes.condition import RecordCondition, record_condition
from retuner.adaptive.indexes.harmonics import half_wave_shape, phase_deg, refined_frequency, tones
from retuner.adaptive.indexes.output_limits import AtLimits, at_limits
from retuner.adaptive.indexes.recording_quality import recording_quality
from retuner.adaptive.indexes.setpoint_responses import idle_index, setpoint_responses
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values

# ---- Shape of the curve that pv draws over co

STEADY = 0.4307
"""Increments within this many of their standard deviations are steady: a third of those of Gaussian noise."""
LEAST_SPREAD = 1e-9  # determinant of the correlation matrix below which the curve is a straight line


def ellipse(pv: FloatArray, co: FloatArray) -> tuple[float, float] | None:
    """Stick band (the ellipse's width along co, co units) and roundness of the curve, shapes (n,); None when pv or co
    stands still or the curve is a straight line.
    """
    x, y = detrended(co), detrended(pv)
    s_x, s_y = float(np.std(x)), float(np.std(y))
    if s_x <= 0 or s_y <= 0:
        return None
    x, y = x / s_x, y / s_y
    c = float(np.mean(x * y))
    if 1 - c * c < LEAST_SPREAD:
        return None
    radius2 = (x * x - 2 * c * x * y + y * y) / (1 - c * c)
    return 2 * (2 * (1 - c * c)) ** 0.5 * s_x, float(np.std(radius2)) / 2


def yamashita(pv: FloatArray, co: FloatArray) -> tuple[float, float] | None:
    """rho1 and rho3, each about -0.5 to 1; None when nothing moves.

    pv, co : shape (n,), sampled so that an oscillation has some 10 to 40 samples.

    Source: Yamashita (2006), Control Engineering Practice 14, 503-510.
    """
    c, p = _symbols(co), _symbols(pv)
    moving = (c != 0) | (p != 0)
    count = int(np.sum(moving))
    if not count:
        return None
    standing = (c != 0) & (p == 0)
    last, before = slice(1, None), slice(None, -1)
    up, c2, p2 = c[before], c[last], p[last]
    follows = standing[before] & ((p2 == -up) | ((c2 == -up) & (p2 != 0)))
    return float(np.sum(standing)) / count, float(np.sum(standing) - np.sum(follows)) / count


def _symbols(x: FloatArray) -> FloatArray:
    """+1 rising, 0 steady, -1 falling, per increment."""
    steps = np.diff(x)
    return np.asarray(np.where(np.abs(steps) > STEADY * float(np.std(steps)), np.sign(steps), 0.0), dtype=np.float64)


# Cross-correlation of co and pv round lag 0 (Horch 1999): odd for a sticking valve, even for other oscillations.
#
#     r(k) = sum_i co_i pv_(i+k),     t_l, t_r   lags of the first zero crossings left and right of lag 0,
#     dtau = |t_l - t_r| / (t_l + t_r),
#     drho = |r(0) - r_opt| / |r(0) + r_opt|,   r_opt = sign(r(0)) max |r(k)|,  -t_l <= k <= t_r
#
# Both lie in 0 to 1: above 2/3 the correlation is odd (a sticking valve in a self-regulating loop with PI control),
# below 1/3 it is even (aggressive tuning, outside oscillation). Not for integrating processes: there both cases look
# alike.

NO_CORRELATION = 0.02  # correlations within this share of the largest one count as zero


def cross_correlation(pv: FloatArray, co: FloatArray) -> tuple[float, float] | None:
    """Horch's dtau and drho, 0 even to 1 odd; None where the correlation does not cross zero on both sides of lag 0.

    pv, co : an oscillating record, shape (n,).

    Source: Horch (1999), Control Engineering Practice 7, 1221-1231.
    """
    n = len(pv)
    length = 1 << (2 * n - 1).bit_length()
    product = np.fft.rfft(detrended(pv), length) * np.fft.rfft(detrended(co), length).conj()
    circular = np.fft.irfft(product)
    reach = n // 2
    r = np.concatenate([circular[-reach:], circular[: reach + 1]])
    largest = float(np.max(np.abs(r)))
    if largest <= 0:
        return None
    at = crossings(r, NO_CORRELATION * largest) - reach
    left, right = at[at < 0], at[at >= 0]
    if not left.size or not right.size:
        return None
    t_l, t_r = -float(left[-1]), float(right[0])
    part = r[reach + int(np.ceil(-t_l)) : reach + int(t_r) + 1]
    r0 = float(r[reach])
    sign = 1.0 if r0 >= 0 else -1.0
    r_opt = sign * float(np.max(np.abs(part), initial=abs(r0)))
    drho = abs(r0 - r_opt) / abs(r0 + r_opt) if r0 + r_opt else 1.0
    return abs(t_l - t_r) / (t_l + t_r), drho


# Kurtosis of a signal: how its values are spread.
#
#     kurtosis: fourth central moment over the squared variance, E[(x - m)^4] over E[(x - m)^2] squared
#
# Square wave 1, sine 1.5, triangle 1.8, Gaussian noise 3; more for rare large excursions.


def kurtosis(x: FloatArray) -> float | None:
    """Kurtosis of a signal without its trend, at least 1; None for a constant. Shape (n,). Source: Pearson (1905)."""
    flat = detrended(x)
    scale = float(np.max(np.abs(flat)))
    if scale <= 1e-12 * float(np.max(np.abs(x))):
        return None
    flat = flat / scale
    return float(np.mean(flat**4) / np.mean(flat**2) ** 2)


FEWEST_CYCLES = 2.0  # cycles in the record for the shape of an oscillation to be looked at
SHAPE_STRENGTH = 0.1
"""Strength from which that is done: limit cycles are often irregular, and the evidence is worth having."""
FEWEST_MOVING = 10  # samples of co off its limits that are needed to judge its recording
STRETCHES_PER_PERIOD = 20  # samples per period that the indexes of movement work on
IAE_AMPLITUDE = 0.1
"""Smallest amplitude for the IAE detector as a share of the range of the error (its 1 % of span is not in a record)."""
NOISE_BAND = 3.0  # standard deviations of noise that the bands of this file hold
SMOOTHED = 25  # samples per period after smoothing, for indexes that look at shape or increments


@dataclass(frozen=True, slots=True)
class Screening:
    """What the classic indexes say of a record.

    condition : whether there is a loop at work at all. evidence : finite numbers by name (glossary.py), only those
        that apply. period_s : period of a regular, lasting oscillation in seconds, None when there is none (the
        evidence may still hold the period and shape of an irregular one).
    limits : time of co at its limits.
    """

    condition: RecordCondition
    evidence: MappingProxyType[str, float]
    period_s: float | None
    limits: AtLimits

    @property
    def oscillates(self) -> bool:
        """Whether the error, or co, oscillates regularly and lastingly."""
        return self.period_s is not None


def screen(
    window: Window,
    gains: PidGains | None = None,
    co_min: float | None = None,
    co_max: float | None = None,
    *,
    in_auto: bool = False,
) -> Screening:
    """Collect the indexes of a record; some 10 ms for 1000 samples.

    window : the record. gains : controller in force, for the idle index, the phase's sign and the ratio to tau_I.
    co_min, co_max : limits of co where known; else they are recognised when co stands at them. in_auto : see
        record_condition.
    """
    limits = at_limits(window.co, co_min, co_max, window.sp - window.pv)
    wave = regularity(window.sp - window.pv)
    if wave is None or not wave.lasting:  # the oscillation of co then, if it has one
        output = regularity(window.co)
        wave = output if output is not None and (output.lasting or wave is None) else wave
    lasting = wave is not None and wave.lasting
    state = record_condition(window, limits.low + limits.high, oscillates=lasting, in_auto=in_auto)
    found: dict[str, float | None] = {
        "at_low_limit": limits.low,
        "at_high_limit": limits.high,
        "limits_hit": float(limits.hit),
        **plain_values(state, "still_share sp_moving_share offset"),
        **_recording(window, limits),
    }
    seen = setpoint_responses(window.sp, window.pv)
    if seen is not None:
        found |= {"setpoint_steps": float(seen.steps), "setpoint_size": seen.size}
        found |= {"overshoot": seen.overshoot, "damping": seen.damping}
    period_s = None
    if np.ptp(window.pv) > 0 and np.ptp(window.co) > 0:
        e = window.sp - window.pv
        width = max(int(wave.period / STRETCHES_PER_PERIOD), 1) if wave is not None else 3
        found |= {
            "jump_share": jump_share(window.pv, window.co),
            "flat_share": flat_share(window.pv, window.co, width),
            "kurtosis_pv": kurtosis(window.pv),
            "kurtosis_co": kurtosis(window.co),
            "decay_ratio": decay_ratio(e),
        }
        if gains is not None and np.ptp(window.sp) == 0:
            found["idle_index"] = idle_index(window.pv, window.co, gains.direction, width)
        if wave is not None:
            found |= {"regularity": wave.regularity, "cycles": wave.cycles, "strength": wave.strength}
        if wave is not None and wave.cycles >= FEWEST_CYCLES and wave.strength >= SHAPE_STRENGTH:
            more, refined_s = _shape(window, gains, wave.period * window.sample_time_s)
            found |= more
            period_s = refined_s if wave.lasting else None
    found |= _detection(window, gains, period_s)
    kept = {name: float(v) for name, v in found.items() if v is not None and math.isfinite(v)}
    return Screening(state, MappingProxyType(kept), period_s, limits)


def _recording(window: Window, limits: AtLimits) -> dict[str, float | None]:
    """Noise and recording, of pv and co; standing at a limit is no compression."""
    low, high = np.min(window.co), np.max(window.co)
    moving = window.co[(window.co > low) & (window.co < high)] if limits.hit else window.co
    pv = recording_quality(window.pv)
    co = recording_quality(moving) if len(moving) > FEWEST_MOVING else None
    found: dict[str, float | None] = {}
    if pv is not None:
        found |= plain_values(pv, "noise_share quantum_pv=quantum repeated_pv=repeated compression_pv=compression")
    if co is not None:
        found |= {"quantum_co": co.quantum, "repeated_co": co.repeated, "compression_co": co.compression}
    return found


def _shape(window: Window, gains: PidGains | None, period_s: float) -> tuple[dict[str, float | None], float]:
    """What applies to an oscillation, and its refined period."""
    e = window.sp - window.pv
    w = refined_frequency(window.t_s, e, 2 * math.pi / period_s)
    period_s = 2 * math.pi / w
    n = period_s / window.sample_time_s
    found: dict[str, float | None] = {"period_s": period_s}
    both = tones(window.t_s, w, window.pv, window.co)
    if both is not None:
        pv, co = both
        found |= {
            "tone_share": pv.share,
            "tone_share_co": co.share,
            "third_harmonic": pv.third,
            "distortion": pv.distortion,
            "distortion_co": co.distortion,
            "even_harmonics": pv.even,
            "amplitude_pv": pv.amplitude,
            "amplitude_co": co.amplitude,
        }
        if gains is not None:
            found["phase_deg"] = phase_deg(pv, co, gains.direction)
    if gains is not None and gains.ki and gains.kp:
        found["period_to_tau_i"] = period_s * gains.ki / gains.kp
    return found | _pictures(window.pv, window.co, n), period_s


def _pictures(pv: FloatArray, co: FloatArray, n: float) -> dict[str, float | None]:
    """Indexes that look at the shape of the waves; n : samples per period."""
    width = max(int(n / SMOOTHED), 1)
    found: dict[str, float | None] = {}
    # without what is slower than two periods, smoothed over width samples
    smooth = {name: running_mean(x, width) if width > 1 else x for name, x in (("pv", pv), ("co", co))}
    waves = {name: smooth[name] - running_mean(x, 2 * round(n) + 1) for name, x in (("pv", pv), ("co", co))}
    for name, x in waves.items():
        noise = noise_sigma(x) if width == 1 else noise_sigma(pv if name == "pv" else co) / width**0.5
        band = max(NOISE_BAND * noise, 0.2 * float(np.std(x)))
        shape = half_wave_shape(x, band)
        if shape is not None:
            found |= {
                f"triangle_{name}": shape.triangle_index,
                f"relay_{name}": shape.relay_index,
                f"asymmetry_{name}": shape.asymmetry,
            }
    pair = cross_correlation(waves["pv"], waves["co"])
    if pair is not None:
        found |= {"horch_dtau": pair[0], "horch_drho": pair[1]}
    curve = ellipse(waves["pv"], waves["co"])
    if curve is not None:
        found |= {"stick_band": curve[0], "roundness": curve[1]}
    symbols = yamashita(pv[::width], co[::width])
    if symbols is not None:
        found |= {"yamashita_rho1": symbols[0], "yamashita_rho3": symbols[1]}
    return found


def _detection(window: Window, gains: PidGains | None, period_s: float | None) -> dict[str, float | None]:
    """Hagglund's IAE detector; the integral time stands for the ultimate period, as in the paper."""
    e = window.sp - window.pv
    amplitude = max(IAE_AMPLITUDE * float(np.ptp(e)) / 2, NOISE_BAND * noise_sigma(e))
    w = 2 * math.pi / period_s if period_s is not None else 0.0
    if gains is not None and gains.ki and gains.kp:
        w = 2 * math.pi * gains.ki / gains.kp
    if not w or amplitude <= 0:
        return {}
    loads, count = iae_detection(window.t_s, e, amplitude, w)
    return {"iae_loads": float(loads), "iae_count": count}


# Does pv move in jumps while co moves steadily, or stand still while co moves? Both are a sticking valve's doing.
#
#     jump share = (travel of pv in its largest increments) / (all its travel)  -  the same of co
#     flat share = (travel of co while pv stands) / (all travel of co)
#
# travel: sum of |increments|; the largest increments: the largest twentieth of them. The same number of co is taken
# off because setpoint steps and disturbances make both jump. Gaussian increments hold 0.147 of their travel in their
# largest twentieth, a ramp 0.05, a square wave nearly all. No published index: the diagnosis study found the first
# the best addition to fitted hypotheses on real records. The second takes up the flat stretches of Yamashita (2006)
# for slower sampling; pv stands where it changes by less than its noise band over a stretch in which co moves out of
# its own.

LARGEST = 0.05  # share of the increments that counts as jumps
FEWEST_INCREMENTS = 40  # increments needed: two jumps in a twentieth


def jump_share(pv: FloatArray, co: FloatArray) -> float | None:
    """Jump share of pv over that of co, -1 to 1, shapes (n,); None for short or constant signals."""
    shares = []
    for x in (pv, co):
        steps = np.sort(np.abs(np.diff(x)))
        travel = float(np.sum(steps))
        if len(steps) < FEWEST_INCREMENTS or travel <= 0:
            return None
        shares.append(float(np.sum(steps[len(steps) - round(LARGEST * len(steps)) :])) / travel)
    return shares[0] - shares[1]


def flat_share(pv: FloatArray, co: FloatArray, width: int) -> float | None:
    """Share of co's travel during which pv stands still, 0 to 1; None when co never moves out of its noise.

    pv, co : shape (n,). width : samples per stretch; about a twentieth of the oscillation's period.
    """
    if len(pv) < 3 * width:
        return None
    moves = []
    for x in (pv, co):
        means = x[: len(x) // width * width].reshape(-1, width).mean(axis=1)
        moves.append((np.abs(np.diff(means)), NOISE_BAND * noise_sigma(x) * (2.0 / width) ** 0.5))
    (d_pv, band_pv), (d_co, band_co) = moves
    moving = d_co > max(band_co, 0.1 * float(np.mean(d_co)))
    travel = float(np.sum(d_co[moving]))
    # without noise "standing" needs a scale: a tenth of pv's mean movement
    still = d_pv <= max(band_pv, 0.1 * float(np.mean(d_pv)))
    return float(np.sum(d_co[moving & still])) / travel if travel > 0 else None
