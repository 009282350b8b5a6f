"""How a run went, region by region: gains, Ms on the true process, and integrated absolute error (IAE).

IAE is compared with the same run (same noise, same scenario) under fixed gains. Where the plant is simulated its true
linear model is known at every operating point, and Ms is the largest over the setpoints visited in the region, with
half a sampling interval of dead time added for the sampled controller; under the gains in force there, which with an
interpolated table are no region's own. A load under which the region was only left, in less than the dead time, is no
operating point: nothing that the controller did came back in it.
"""

import math
from collections.abc import Callable

import numpy as np

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values
from retuner.schedule.table import GainTable

NOISE_BANDS, CO_FLOOR = 8.0, 10.0
"""Least height of a drawn axis: noise bands of pv (standard deviations), and co units. A loop at rest looks at rest."""


def axis_floors(pv: FloatArray) -> tuple[float, float]:
    """The least heights of the axes of pv and co. pv : what is drawn, shape (n,)."""
    known = pv[np.isfinite(pv)]
    return NOISE_BANDS * noise_sigma(known) if len(known) > 2 else 0.0, CO_FLOOR


Linearise = Callable[..., LinearProcess]  # true process at a pv, and at a load where that is not 0
Columns = dict[str, FloatArray]
SETTLING = 10  # Samples after a setpoint step in which another event still counts as the same one
POINTS = 9  # operating points per region at which the true Ms is looked at


@dataclass(frozen=True, slots=True)
class RegionScore:
    """One region of a run. iae in pv units times seconds; ms NaN-free: None where the true process is not known."""

    region: str
    before: PidGains
    after: PidGains
    changes: int
    ms_before: float | None
    ms_after: float | None
    iae: float
    iae_fixed: float | None

    def to_dict(self) -> dict[str, object]:
        """Plain values; an infinite Ms (unstable) is null with stable_... false."""
        return {
            **plain_values(self, "region before after changes ms_before ms_after"),
            "stable_before": _stable(self.ms_before),
            "stable_after": _stable(self.ms_after),
            **plain_values(self, "iae iae_fixed"),
        }


def _stable(value: float | None) -> bool | None:
    return None if value is None else math.isfinite(value)


def region_scores(
    before: GainTable,
    after: GainTable,
    commits: list[tuple[float, int]],
    run: Columns,
    fixed: Columns | None,
    linearise: Linearise | None,
    sample_time_s: float,
    tau_f_s: float = 0.0,
    loads: FloatArray | None = None,
) -> list[RegionScore]:
    """Score every region.

    before, after : gain tables. commits : (time, region) of each change. run, fixed : trends by column, of which the
        second counts as far as the first goes, which may have been stopped.
    linearise : true linear process at a pv, where the plant is simulated. tau_f_s : filter of the derivative, s.
    loads : load on the plant in each row of run, percent; None for none.
    """
    scores = []
    fixed = fixed and {name: x[fixed["t"] <= run["t"][-1]] for name, x in fixed.items()}
    for i, name in enumerate(before.regions.names):
        inside = np.flatnonzero(run["region"] == i)
        # the true process over the setpoints visited, under each load that was on it, and the scheduling values there
        truths: list[tuple[LinearProcess, float, float]] = []
        if linearise is not None and inside.size:
            loaded = np.zeros(len(inside)) if loads is None else loads[inside]
            for load in np.unique(loaded).tolist():
                rows = inside[loaded == load]
                visited = run["sp"][rows]
                stayed_s = max(map(len, np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1))) * sample_time_s
                for pv in np.linspace(visited.min(), visited.max(), POINTS).tolist():
                    process = linearise(pv, load) if load else linearise(pv)
                    if stayed_s <= process.theta_s < len(inside) * sample_time_s:
                        continue
                    row = int(rows[np.argmin(np.abs(visited - pv))])
                    x, x2 = (float(run[name][row]) if name in run else 0.0 for name in ("x", "x2"))
                    truths.append((process.seen_by_controller(sample_time_s), x, x2))
        ms: list[float | None] = []
        for table in (before, after):
            peaks = []
            for process, x, x2 in truths:
                # the region's own set where a scheduling value was not known
                known = math.isfinite(x) and math.isfinite(x2)
                gains = table.at(i, x, x2) if known else table.gains_of(i)
                peaks.append(sensitivity_peak(process, gains, tau_f_s))
            ms.append(max(peaks, default=None))

        scores.append(
            RegionScore(
                region=name,
                before=before.gains_of(i),
                after=after.gains_of(i),
                changes=sum(1 for _, region in commits if region == i),
                ms_before=ms[0],
                ms_after=ms[1],
                iae=iae(run, i),
                iae_fixed=None if fixed is None else iae(fixed, i),
            )
        )
    return scores


def iae(columns: Columns, region: int) -> float:
    """Integral of |sp - pv| over the time spent in a region, pv units times seconds."""
    t, inside = columns["t"], columns["region"] == region
    return float(np.sum(np.abs(columns["sp"] - columns["pv"])[inside] * np.diff(t, append=t[-1])[inside]))


@dataclass(frozen=True, slots=True)
class Twin:
    """One step twice in one region: indexes of the samples [start, end) of its first and its last occurrence."""

    region: int
    first: tuple[int, int]
    last: tuple[int, int]
    text: str


def twin_steps(columns: Columns, events_s: list[float]) -> list[Twin]:
    """The setpoint step of each region that occurs twice with the longest time between: before and after learning.

    events_s : times at which something else begins (loads), where a step's response is cut off.
    """
    sp, region = columns["sp"], columns["region"].astype(int)
    moves = np.flatnonzero(np.diff(sp)) + 1
    others = np.searchsorted(columns["t"], np.asarray(events_s, dtype=np.float64))
    cuts = np.unique(np.concatenate([moves, others, [len(sp)]]))
    seen: dict[tuple[int, float, float], list[tuple[int, int]]] = {}
    for start in moves[moves <= len(sp) - SETTLING].tolist():  # what comes later shows nothing of a response
        end = int(cuts[np.searchsorted(cuts, start + SETTLING, side="left")])
        if region[start - 1] == region[min(start + 1, len(sp) - 1)]:
            seen.setdefault((int(region[start]), float(sp[start - 1]), float(sp[start])), []).append((start, end))
    best: dict[int, Twin] = {}
    for (i, low, high), places in seen.items():
        if len(places) > 1:
            twin = Twin(i, places[0], places[-1], f"setpoint {low:.4g} to {high:.4g}")
            held = best.get(i)
            if held is None or twin.last[0] - twin.first[0] > held.last[0] - held.first[0]:
                best[i] = twin
    return [best[i] for i in sorted(best)]
