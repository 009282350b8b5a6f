"""What each number of the evidence means: words, unit, how to read it, and where it comes from.

Unit "share" is 0 to 1, "ratio" and "index" have none, "pv" and "co" are the record's own units.
"""

from typing import NamedTuple


class Entry(NamedTuple):
    """Words for a number. unit : see above, or s, deg, count. reading : how to read it. source : author and year."""

    words: str
    unit: str
    reading: str
    source: str


# fmt: off
GLOSSARY: dict[str, Entry] = {
    "period_s": Entry("oscillation period", "s", "", "Thornhill, Huang & Zhang 2003"),
    "cycles": Entry("cycles in the record", "count", "fewer than 5: little evidence", ""),
    "regularity": Entry("regularity of the oscillation", "index", "above 1: regular", "Thornhill, Huang & Zhang 2003"),
    "strength": Entry("share of the error that keeps oscillating", "share", "above 0.3: lasting", ""),
    "decay_ratio": Entry("half-cycle decay ratio", "ratio", "above 0.5: too oscillatory", "Miao & Seborg 1999"),
    "iae_loads": Entry("half cycles that count", "count", "", "Hagglund 1995"),
    "iae_count": Entry("oscillation detector", "count", "above 10: oscillates", "Hagglund 1995"),
    "setpoint_steps": Entry("setpoint responses", "count", "", ""),
    "setpoint_size": Entry("size of setpoint steps", "pv", "", ""),
    "overshoot": Entry("overshoot of setpoint responses", "share", "0.05 to 0.2 is usual", "Foxboro TI 039-200"),
    "damping": Entry("decay ratio, setpoint responses", "ratio", "0 dead-beat, 1 sustained", "Foxboro TI 039-200"),
    "idle_index": Entry("idle index", "index", "near 1: sluggish", "Hagglund 1999"),
    "period_to_tau_i": Entry("period over integral time", "ratio", "large: integral too strong", "Skogestad 2003"),
    "phase_deg": Entry("phase of pv against co", "deg", "", ""),
    "tone_share": Entry("share of pv in one sinusoid", "share", "near 1: sinusoidal", ""),
    "tone_share_co": Entry("share of co in one sinusoid", "share", "near 1: sinusoidal", ""),
    "amplitude_pv": Entry("amplitude of pv", "pv", "", ""),
    "amplitude_co": Entry("amplitude of co", "co", "", ""),
    "third_harmonic": Entry("third harmonic of pv", "ratio", "sine 0, triangle 0.11, square 0.33", ""),
    "distortion": Entry("harmonics 2 to 5 of pv", "ratio", "sine 0, triangle 0.12, square 0.39", ""),
    "distortion_co": Entry("harmonics 2 to 5 of co", "ratio", "sine 0, triangle 0.12, square 0.39", ""),
    "even_harmonics": Entry("even harmonics of pv", "ratio", "saw 0.56, waves with equal halves 0", ""),
    "triangle_pv": Entry("pv: triangle against sine", "index", "above 0.6 triangle, below 0.4 sine", "He et al. 2007"),
    "triangle_co": Entry("co: triangle against sine", "index", "above 0.6 triangle, below 0.4 sine", "He et al. 2007"),
    "relay_pv": Entry("pv: relay response against sine", "index", "above 0.21 relay", "Rossi & Scali 2005"),
    "relay_co": Entry("co: relay response against sine", "index", "above 0.21 relay", "Rossi & Scali 2005"),
    "asymmetry_pv": Entry("skew of pv's half cycles", "index", "0 even, 0.4 a saw", ""),
    "asymmetry_co": Entry("skew of co's half cycles", "index", "0 even, 0.4 a saw", ""),
    "kurtosis_pv": Entry("kurtosis of pv", "ratio", "square 1, sine 1.5, noise 3", "Pearson 1905"),
    "kurtosis_co": Entry("kurtosis of co", "ratio", "square 1, sine 1.5, noise 3", "Pearson 1905"),
    "horch_dtau": Entry("cross-correlation, lags", "index", "above 0.67 odd: valve", "Horch 1999"),
    "horch_drho": Entry("cross-correlation, heights", "index", "above 0.67 odd: valve", "Horch 1999"),
    "yamashita_rho1": Entry("pv steady while co moves", "share", "chance 0.25; well above: valve", "Yamashita 2006"),
    "yamashita_rho3": Entry("the same, less what no valve does", "share", "well above 0.25: valve", "Yamashita 2006"),
    "stick_band": Entry("width of pv over co", "co", "stiction band if a valve sticks", "Choudhury 2008"),
    "roundness": Entry("pv over co, unlike an ellipse", "index", "ellipse 0, parallelogram 0.2 to 0.45, noise 1", ""),
    "jump_share": Entry("jumps of pv beyond those of co", "share", "above 0.1: jumps", ""),
    "flat_share": Entry("travel of co while pv is still", "share", "near 1: pv does not follow", ""),
    "noise_share": Entry("noise in pv", "share", "of its variance", ""),
    "quantum_pv": Entry("resolution of pv", "pv", "0: none seen", ""),
    "quantum_co": Entry("resolution of co", "co", "0: none seen", ""),
    "repeated_pv": Entry("pv samples that repeat the last one", "share", "", ""),
    "repeated_co": Entry("co samples that repeat the last one", "share", "", ""),
    "compression_pv": Entry("compression of pv by the recorder", "ratio", "above 3: distrust shapes", "Thornhill 2004"),
    "compression_co": Entry("compression of co by the recorder", "ratio", "above 3: distrust shapes", "Thornhill 2004"),
    "at_low_limit": Entry("share of time with co at its lower limit", "share", "", ""),
    "at_high_limit": Entry("share of time with co at its upper limit", "share", "", ""),
    "limits_hit": Entry("limits of co touched", "count", "", ""),
    "still_share": Entry("share of time with co constant", "share", "above 0.6: manual", ""),
    "sp_moving_share": Entry("samples with a new setpoint", "share", "above 0.3: the inner loop of a cascade", ""),
    "offset": Entry("mean error over its spread", "ratio", "above 6: pv is not held at its setpoint", ""),
}
# fmt: on
