"""A record made ready for fitting: its own clock from zero, its noise, its scale, and where its time has gaps."""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.fit.dynamics import Clock
from retuner.adaptive.fit.rests import RestRatio, rest_ratios
from retuner.adaptive.indexes.recording_quality import hidden_sigma
from retuner.adaptive.signals.noise import noise_sigma, quantum_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

GAP = 3.5
"""An interval this many times the usual one is a gap: what co did meanwhile is not known."""
MOST_GAPS = 4
"""More gaps than this are no longer bridged by a state of their own each; the longest are."""
START_SAMPLES, START_SHARE = 6, 50
"""The start is this many samples, or one part in so many of the record, whichever is more."""
LEAST_MOTION = 0.003
"""A start that moves by less than this share of pv's range is rest."""
MOTION_REACH = 5.0
"""The unknown time before the record may have moved so many times as much as the start."""
LEAST_NOISE = 1e-6
"""A record without noise is fitted to this share of pv's range: finer than any instrument, coarser than rounding."""


@dataclass(frozen=True, slots=True)
class Record:
    """What a fit needs of a record.

    t_s, pv, co : shape (n,), t_s from zero. co is counted from its first value.
    clock : the instants. sample_time_s : median interval. span_s : length.
    noise_std : standard deviation of the noise on pv by itself, pv units. resolution : nothing finer than this is in pv
        (a share of its range, or its quantum), as a standard deviation. pv_range, co_range : largest minus smallest.
    gaps_s : instants at which a gap in time ends. motion_at_start : how much pv moves at once when the record begins,
        as a share of its range: 0 from rest. The co of the time before the record will have moved as much, and no more.
    barred_s : setpoint changes at which no load step is to stand (coincident_loads.py), from zero.
    rests : co over pv from rest to rest (rests.py). logged_s : median interval before the record was condensed.
    """

    pv: FloatArray
    co: FloatArray
    clock: Clock
    sample_time_s: float
    span_s: float
    noise_std: float
    resolution: float
    pv_range: float
    co_range: float
    gaps_s: tuple[float, ...]
    motion_at_start: float
    barred_s: tuple[float, ...] = ()
    rests: tuple[RestRatio, ...] = ()
    logged_s: float = 0.0

    @classmethod
    def of(cls, window: Window, most_samples: int | None = None) -> "Record":
        """Prepare a window, condensed to most_samples."""
        hidden, rests, logged_s = hidden_sigma(window.pv), rest_ratios(window), window.sample_time_s
        window = window if most_samples is None else window.condensed(most_samples)
        t = window.t_s - window.t_s[0]  # seconds since 1970 leave too few digits for derivatives by the dead time
        pv_range = float(np.ptp(window.pv))
        resolution = max(quantum_sigma(window.pv), hidden, LEAST_NOISE * pv_range)
        noise = max(noise_sigma(window.pv), resolution, window.noise_std)
        dt = window.sample_time_s
        # Where the longest gaps end, in order
        lengths = np.diff(t)
        longest = np.argsort(-lengths, kind="stable")[:MOST_GAPS]
        # Travel of pv in the first samples beyond its noise, as a share of its range, and somewhat more
        m = min(max(START_SAMPLES, len(window.pv) // START_SHARE), len(window.pv))
        travel = abs(float(np.median(window.pv[m - 3 : m]) - np.median(window.pv[:3]))) - 2 * noise
        share = travel / (float(np.ptp(window.pv)) or 1.0)
        return cls(
            np.ascontiguousarray(window.pv),
            window.co - window.co[0],
            Clock.of(t),
            dt,
            float(t[-1]),
            noise,
            resolution,
            pv_range,
            float(np.ptp(window.co)),
            tuple(float(t[i + 1]) for i in sorted(longest.tolist()) if lengths[i] > GAP * dt),
            (min(MOTION_REACH * share, 1.0) if share > LEAST_MOTION else 0.0),
            rests=rests,
            logged_s=logged_s,
        )

    @property
    def t_s(self) -> FloatArray:
        """Sampling instants from zero, shape (n,)."""
        return self.clock.t_s
