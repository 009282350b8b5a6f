"""Processes of the grid with their odds: Ms of a set of gains on each, and what the set costs over them.

    cost = ln IAE + RISK ln(Ms / ms_calm)+       (unstable: ln(1/ki) + UNSTABLE)

IAE is that after a unit load step: 1/ki times what iae_over_ie (process_grid.py) says. The second term is what too
little robustness costs.
"""

import math

import numpy as np

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.explanations.process_grid import (
    DEAD_TIMES,
    FREQUENCIES,
    GAINS,
    HALF_TURN,
    BoolArray,
    ComplexArray,
    ProcessShape,
    control_law,
    iae_over_ie,
    loop_phases,
    shapes,
)
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field


@dataclass(frozen=True, slots=True)
class WorthSettings:
    """When settings are given. Costs are logarithms of IAE. SIMC's own Ms is 1.59 to 1.70."""

    worth: float = setting(0.25, "How much cheaper settings must be expected to be", "0.1..0.7")
    ms_bad: float = setting(1.8, "Ms that no more than bad_share of the odds may have", "1.1..3.5")
    bad_share: float = setting(0.1, "Share of the odds that may come out badly", "0.02..0.2")
    unstable_share: float = setting(0.01, "Share of the odds that may be unstable", "0..0.05")
    ms_calm: float = setting(1.6, "Ms up to which robustness costs nothing", "1.1..3.5")
    risk: float = setting(5.0, "Cost of Ms over it, per logarithm", "2..10")
    unstable: float = setting(8.0, "Cost of an unstable loop", "2..20")
    most_at_once: float = setting(
        3.0, "Factor on gain and integral action that a record carries", "1.5..4", "first_step.py"
    )
    least_at_once: float = setting(0.25, "The same on the gain towards less", "0.1..0.5")
    processes: int = setting(250, "Likeliest processes that sets are weighed on", "50..1000")
    rules: int = setting(8, "Likeliest processes whose settings are tried", "1..50")

    def __post_init__(self) -> None:
        require_in_range(self, "settings by odds")


@dataclass(frozen=True, slots=True)
class LikelyProcesses:
    """The likeliest processes of the grid.

    index : of shape, dead time and gain. weights : sum 1. responses : G(jw), shape (processes, frequencies).
    later : dead time beside that of the grid, samples. asked : Ms by gains, which are asked for again and again.
    """

    index: tuple[tuple[int, int, int], ...]
    weights: FloatArray
    responses: ComplexArray
    sample_time_s: float
    later: FloatArray = field(default_factory=lambda: np.zeros(1))
    asked: dict[PidGains, FloatArray] = field(default_factory=dict, init=False)

    def peaks(self, gains: PidGains) -> FloatArray:
        """Ms on each process, infinite where the loop is unstable; shape (processes,)."""
        if gains not in self.asked:
            ms = 1.0 / np.min(np.abs(1.0 + self.responses * control_law(gains, self.sample_time_s)), axis=1)
            self.asked[gains] = np.where(self.stable(gains), ms, np.inf)
        return self.asked[gains]

    def stable(self, gains: PidGains) -> BoolArray:
        """Which of the loops are stable, shape (processes,)."""
        law, away, (rows, dead, _) = control_law(gains, self.sample_time_s), self.runs_away, np.array(self.index).T
        phases = loop_phases(rows, dead, law) - self.later[:, None] * FREQUENCIES
        size, over = np.abs(self.responses) * np.abs(law), phases > HALF_TURN
        falls, rises = over[:, :-1] & ~over[:, 1:], ~over[:, :-1] & over[:, 1:]
        large = size[:, :-1] * size[:, 1:] >= 1.0
        stable = ~(falls & large).any(axis=1) & over[:, 0]
        if away.any():  # one turn round -1 holds one pole (Nyquist's criterion); a rise may lie below the frequencies
            turns = (rises & large).sum(axis=1) - (falls & large).sum(axis=1)
            turns += over[:, 0] & (size[:, 0] >= 1.0)
            stable = np.where(away, turns == 1, stable)
        return np.asarray(stable, dtype=np.bool_)

    @property
    def runs_away(self) -> BoolArray:
        """Which of the processes run away by themselves, shape (processes,)."""
        return np.array([i >= len(shapes()) for i, _, _ in self.index])


def over_cells(likely: LikelyProcesses, drawn: int) -> LikelyProcesses:
    """The processes spread over their cells, which reach half way to the next gain and dead time: what is told of Ms is
    to hold between the points of the grid, also where one has all odds. drawn : of how many draws they came; a process
    is spread as often as it was drawn, at the most IN_CELL times, on a lattice of rank one (Korobov 1959).
    """
    parts = np.clip(np.round(likely.weights * drawn).astype(int), 1, IN_CELL)
    at = np.repeat(np.arange(len(parts)), parts)
    place = np.arange(len(at)) - (np.cumsum(parts) - parts)[at] - (parts[at] - 1) / 2
    gain, across = np.exp(GAIN_STEP * place / parts[at]), (GOLDEN * place + 0.5) % 1.0 - 0.5
    index = tuple(likely.index[i] for i in at)
    below, above = (steps[[j for _, j, _ in index]] for steps in DEAD_STEPS)
    later = across * np.where(across < 0.0, below, above)
    responses = likely.responses[at] * gain[:, None] * np.exp(-1j * later[:, None] * FREQUENCIES)
    return LikelyProcesses(index, (likely.weights / parts)[at], responses, likely.sample_time_s, later)


IN_CELL, GOLDEN, GAIN_STEP = 8, (math.sqrt(5.0) - 1.0) / 2.0, float(np.log(GAINS[1] / GAINS[0]))
DEAD_STEPS = np.diff(DEAD_TIMES, prepend=DEAD_TIMES[0]), np.diff(DEAD_TIMES, append=DEAD_TIMES[-1])


def process_model(shape: ProcessShape, dead: float, gain: float, direction: int, sample_time_s: float) -> ProcessModel:
    """A process of the grid as a model that a rule takes. dead : in samples. gain : per sample where it integrates."""
    dt = sample_time_s
    theta, second = max(dead, 0.5) * dt, shape.second * dt
    if shape.integrates:
        kind = ProcessType.INTEGRATING_LAG if second else ProcessType.INTEGRATING
        return ProcessModel(kind, direction * gain / dt, 0.0, second, theta)
    kind = ProcessType.SOPDT if second else ProcessType.FOPDT
    return ProcessModel(kind, direction * gain, shape.lag * dt, second, theta)


def quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    """The value that so much of the weight does not exceed."""
    order = np.argsort(values)
    at = int(np.searchsorted(np.cumsum(weights[order]), share))
    return float(values[order[min(at, len(values) - 1)]])


def costs(likely: LikelyProcesses, gains: PidGains, settings: WorthSettings) -> tuple[FloatArray, FloatArray]:
    """Cost of a set (head of this file), and its Ms, on each process."""
    peaks = likely.peaks(gains)
    return _cost(likely.responses, peaks, gains, likely.sample_time_s, settings), peaks


def cost_on(process: LinearProcess, ms: float, gains: PidGains, interval_s: float, settings: WorthSettings) -> float:
    """Cost of a set on a process on which it has this Ms. interval_s : a small part of its lags."""
    response = gains.direction * process.response(FREQUENCIES / interval_s)[None]
    return float(_cost(response, np.array([ms]), gains, interval_s, settings)[0])


def _cost(
    responses: ComplexArray, peaks: FloatArray, gains: PidGains, interval_s: float, settings: WorthSettings
) -> FloatArray:
    stable, risk = np.isfinite(peaks), np.full(len(peaks), settings.unstable)
    over = np.log(np.maximum(peaks[stable] / settings.ms_calm, 1.0))
    risk[stable] = np.minimum(settings.risk * over, settings.unstable)
    if not gains.ki:
        return risk + settings.unstable
    risk[stable] += iae_over_ie(responses[stable], control_law(gains, interval_s))
    return risk - math.log(abs(gains.ki))


def expected_cost(likely: LikelyProcesses, gains: PidGains, settings: WorthSettings) -> tuple[float, FloatArray]:
    """Expected cost of a set, and its Ms on each process."""
    each, peaks = costs(likely, gains, settings)
    return float(likely.weights @ each), peaks


def harmless(
    weights: FloatArray, now: FloatArray, new: FloatArray, settings: WorthSettings, most: float | None = None
) -> bool:
    """Whether a change makes a bad loop of next to no process, and few are bad after it. now, new : Ms on each.
    most : Ms above which a loop is bad; of the settings where it is not given.
    """
    most = settings.ms_bad if most is None else most
    bad = new > most
    made, lost = (float(weights @ one) for one in (bad & (now <= most), np.isinf(new) & ~np.isinf(now)))
    in_all = float(weights @ bad)
    return made <= settings.bad_share and in_all <= IN_ALL * settings.bad_share and lost <= settings.unstable_share


IN_ALL = 2.0  # times bad_share up to which processes may be bad after a change, those that are bad already included
