"""All indexes of a record in one pass: numbers by name for the evidence of a diagnosis.

The period comes first (auto-covariance of the control error, else of co); everything that looks at shapes is measured
in it. What does not apply to a record is left out. glossary.py says what each name means.
"""

import math
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from retuner.adaptive.indexes.autocovariance import Regularity, decay_ratio, iae_detection, regularity, running_mean
from retuner.adaptive.indexes.condition import RecordCondition, record_condition
from retuner.adaptive.indexes.harmonics import half_wave_shape, phase_deg, refined_frequency, tones
from retuner.adaptive.indexes.jumps import flat_share, jump_share
from retuner.adaptive.indexes.limits import AtLimits, at_limits
from retuner.adaptive.indexes.recording_quality import recording_quality
from retuner.adaptive.indexes.setpoint_responses import idle_index, setpoint_responses
from retuner.adaptive.indexes.shapes import cross_correlation, ellipse, kurtosis, yamashita
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains

FEWEST_CYCLES = 2.0
"""Cycles in the record for the shape of an oscillation to be looked at."""
SHAPE_STRENGTH = 0.1
"""Strength from which that is done: limit cycles are often irregular, and the evidence is worth having."""
FEWEST_MOVING = 10
"""Samples of co off its limits that are needed to judge its recording."""
STRETCHES_PER_PERIOD = 20
"""Samples per period that the indexes of movement work on."""
IAE_AMPLITUDE = 0.1
"""Smallest amplitude for the IAE detector as a share of the range of the error (its 1 % of span is not in a record)."""
NOISE_BAND = 3.0
"""Standard deviations of noise that the bands of this file hold."""
SMOOTHED = 25
"""Samples per period after smoothing, for indexes that look at shape or increments."""


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

    Parameters
    ----------
    window : the record. gains : controller in force, for the idle index, the phase's sign and the ratio to tau_I.
    co_min, co_max : limits of co where known; else they are recognised when co stands at them. in_auto : see
        record_condition.
    """
    limits = at_limits(window.co, co_min, co_max, window.sp - window.pv)
    wave = _oscillation(window)
    lasting = wave is not None and wave.lasting
    state = record_condition(window, limits.low + limits.high, oscillates=lasting, in_auto=in_auto)
    found: dict[str, float | None] = {
        "at_low_limit": limits.low,
        "at_high_limit": limits.high,
        "limits_hit": float(limits.hit),
        "still_share": state.still_share,
        "sp_moving_share": state.sp_moving_share,
        "offset": state.offset,
        **_recording(window, limits),
        **_setpoint(window),
    }
    period_s = None
    if np.ptp(window.pv) > 0 and np.ptp(window.co) > 0:
        found |= _movement(window, gains, wave)
        if wave is not None and wave.cycles >= FEWEST_CYCLES and wave.strength >= SHAPE_STRENGTH:
            more, refined_s = _shape(window, gains, wave.period * window.sample_time_s)
            found |= more
            period_s = refined_s if wave.lasting else None
    found |= _detection(window, gains, period_s)
    kept = {name: float(v) for name, v in found.items() if v is not None and math.isfinite(v)}
    return Screening(state, MappingProxyType(kept), period_s, limits)


def _recording(window: Window, limits: AtLimits) -> dict[str, float | None]:
    """Noise and recording, of pv and co; standing at a limit is no compression."""
    moving = (
        (window.co > np.min(window.co)) & (window.co < np.max(window.co))
        if limits.hit
        else np.full(len(window.co), fill_value=True)
    )
    pv = recording_quality(window.pv)
    co = recording_quality(window.co[moving]) if np.sum(moving) > FEWEST_MOVING else None
    found: dict[str, float | None] = {}
    if pv is not None:
        found |= {
            "noise_share": pv.noise_share,
            "quantum_pv": pv.quantum,
            "repeated_pv": pv.repeated,
            "compression_pv": pv.compression,
        }
    if co is not None:
        found |= {"quantum_co": co.quantum, "repeated_co": co.repeated, "compression_co": co.compression}
    return found


def _setpoint(window: Window) -> dict[str, float | None]:
    seen = setpoint_responses(window.sp, window.pv)
    if seen is None:
        return {}
    return {
        "setpoint_steps": float(seen.steps),
        "setpoint_size": seen.size,
        "overshoot": seen.overshoot,
        "damping": seen.damping,
    }


def _oscillation(window: Window) -> Regularity | None:
    """The oscillation of the error, else that of co."""
    error = regularity(window.sp - window.pv)
    if error is not None and error.lasting:
        return error
    output = regularity(window.co)
    return output if output is not None and (output.lasting or error is None) else error


def _movement(window: Window, gains: PidGains | None, wave: Regularity | None) -> dict[str, float | None]:
    """What applies with and without an oscillation."""
    e = window.sp - window.pv
    width = max(int(wave.period / STRETCHES_PER_PERIOD), 1) if wave is not None else 3
    found: dict[str, float | None] = {
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
    waves = {name: _band_passed(x, n, width) for name, x in (("pv", pv), ("co", co))}
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
        found |= {"horch_dtau": pair.dtau, "horch_drho": pair.drho}
    curve = ellipse(waves["pv"], waves["co"])
    if curve is not None:
        found |= {"stick_band": curve.stick_band, "roundness": curve.roundness}
    symbols = yamashita(pv[::width], co[::width])
    if symbols is not None:
        found |= {"yamashita_rho1": symbols[0], "yamashita_rho3": symbols[1]}
    return found


def _band_passed(x: FloatArray, n: float, width: int) -> FloatArray:
    """A signal without what is slower than two periods, smoothed over width samples."""
    slow = running_mean(x, 2 * round(n) + 1)
    return (running_mean(x, width) if width > 1 else x) - slow


def _detection(window: Window, gains: PidGains | None, period_s: float | None) -> dict[str, float | None]:
    """Hagglund's IAE detector; the integral time stands for the ultimate period, as in the paper."""
    e = window.sp - window.pv
    amplitude = max(IAE_AMPLITUDE * float(np.ptp(e)) / 2, NOISE_BAND * noise_sigma(e))
    if gains is not None and gains.ki and gains.kp:
        w = 2 * math.pi * gains.ki / gains.kp
    elif period_s is not None:
        w = 2 * math.pi / period_s
    else:
        return {}
    if amplitude <= 0:
        return {}
    seen = iae_detection(window.t_s, e, amplitude, w)
    return {"iae_loads": float(seen.loads), "iae_count": seen.count}
