"""The test that would settle what a record leaves open: the smallest setpoint step out and back, and its odds.

    D_ij = sum over the test of [A/C (pv_i - x_j)]^2 / s^2          pv_i: process i under the test; x_j: j under i's co
    P(decides) = sum_i P_i min_j Phi((D_ij / 2T + ln P_i/P_j - ln 9) / sqrt(D_ij / T))

A valve that may stay behind co is told by steps of co in manual: D is then between the process's answer and none.

D/2 is the mean of the log-likelihood ratio of two processes under the load and noise that the record has shown (A/C
and s, wandering_load.py), T the temper of a setpoint's doing, and the ratio is normal with variance D. The test decides
where the odds come out at nine to one or more. In each class the processes nearest to one another count.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, gain_unit, shapes
from retuner.adaptive.explanations.proposed_test import DecidingTest, TestKind
from retuner.adaptive.explanations.tuning_odds import CLASSES, TuningLimits, TuningOdds, class_of
from retuner.adaptive.explanations.wandering_load import (
    T_SETPOINT,
    LoadModel,
    Prepared,
    filtered,
    impulse_response,
    likeliest_load,
    responses,
    spectrum,
)
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

SIZES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Sizes tried, in standard deviations of pv's deviation from its setpoint."""
ENOUGH_TO_DECIDE = 0.8
"""The smallest step with this probability to decide is proposed; the largest where none has it."""
DECIDED = math.log(9.0)
"""Odds that decide."""
PROCESSES_PER_CLASS = 8
"""Processes of each class that are told apart from those of the others."""
SHORTEST, LONGEST = 30, 250
"""Samples that the step is held."""
SETTLED = 0.05


def deciding_test(odds: TuningOdds, record: Prepared, error_std: float) -> DecidingTest:
    """The smallest setpoint step that is likely to decide.

    error_std : standard deviation of pv from its setpoint, pv units.
    """
    load, std = _load(odds, record)
    groups = _groups(odds)
    true = [group[0] for group in groups]
    hold = max(_settling(odds, process) for process in true)
    weight = np.array([odds.classes[CLASSES[group[0].kind]] for group in groups])
    weight = np.maximum(weight / float(weight.sum()), 1e-3)
    energy = np.array([_energies(odds, one, groups, hold, load) for one in true]) * (error_std / std) ** 2
    decides = [_decides(energy * size**2, weight) for size in SIZES]
    at = next((i for i, share in enumerate(decides) if share >= ENOUGH_TO_DECIDE), len(SIZES) - 1)
    return DecidingTest(TestKind.SETPOINT, _rounded(SIZES[at] * error_std), hold * odds.sample_time_s, decides[at])


def valve_test(odds: TuningOdds, record: Prepared, co_std: float) -> DecidingTest:
    """The smallest steps of co in manual at which a pv that follows is told from one behind a valve that stays.

    A pv that follows shows D of the head of this file between the process's answer and none; a valve that stays shows
    none. co_std : standard deviation of co in the record, co units.
    """
    load, std = _load(odds, record)
    group = [process for each in _groups(odds) for process in each[:1]]
    weight = np.array([odds.classes[CLASSES[process.kind]] for process in group])
    hold = max(min(_settling(odds, process), LONGEST // 2) for process in group)
    co = np.concatenate([np.full(hold, level) for level in (1.0, 2.0, 1.0, 0.0)])
    white = impulse_response(load.a, load.c, len(co))
    shown = [filtered(spectrum(_answer(process, co)), len(co), white) for process in group]
    energy = np.array([float(d @ d) for d in shown]) * (co_std / std) ** 2
    decides = [float(weight @ [_reaches(float(e) * size**2, 0.0) for e in energy] / weight.sum()) for size in SIZES]
    at = next((i for i, share in enumerate(decides) if share >= ENOUGH_TO_DECIDE), len(SIZES) - 1)
    return DecidingTest(TestKind.VALVE, _rounded(SIZES[at] * co_std), hold * odds.sample_time_s, decides[at])


@dataclass(frozen=True, slots=True)
class _Process:
    """A process of the grid: class, first and second lag, dead time, gain; in samples."""

    kind: int
    lag: float
    second: int
    dead: float
    gain: float


def _groups(odds: TuningOdds) -> list[list[_Process]]:
    """The likeliest processes of each class that has any, the likeliest first."""
    classes = class_of(odds.robustness, odds.gains, odds.sample_time_s, TuningLimits())
    unit = gain_unit(odds.gains, odds.sample_time_s) / odds.robustness.scale
    groups = []
    for kind in range(len(CLASSES)):
        stable = np.isfinite(odds.robustness.ms)
        flat = np.where((classes == kind) & stable, odds.weights, 0.0).ravel()
        chosen = np.argsort(-flat, kind="stable")[:PROCESSES_PER_CLASS]
        found = []
        for at in chosen[flat[chosen] > 0]:
            i, j, k = np.unravel_index(int(at), odds.weights.shape)
            shape = shapes()[int(i)]
            second = sum(other.lag == shape.lag for other in shapes()[: int(i)])
            found.append(_Process(kind, shape.lag, second, DEAD_TIMES[int(j)], float(GAINS[k]) * shape.unit / unit))
        if found:
            groups.append(found)
    return groups


def _load(odds: TuningOdds, record: Prepared) -> tuple[LoadModel, float]:
    """Load and noise that explain the record best beside the likeliest process, and the standard deviation s."""
    i = int(np.unravel_index(int(np.argmax(odds.weights)), odds.weights.shape)[0])
    return likeliest_load(record, shapes()[i].lag)


def _answer(process: _Process, co: FloatArray) -> FloatArray:
    """What a process does under co, from rest."""
    x = responses(co, process.lag)[process.second] * process.gain
    whole, part = int(process.dead), process.dead - int(process.dead)
    late = np.concatenate([np.zeros(whole + 1), x])
    return late[1 : len(co) + 1] * (1 - part) + late[: len(co)] * part


def _closed_loop(odds: TuningOdds, process: _Process, setpoint: FloatArray) -> tuple[FloatArray, FloatArray]:
    """pv and co of the loop from rest under a setpoint, without load; the controller acts on magnitudes."""
    dt, gains = odds.sample_time_s, odds.gains
    kp, ki = abs(gains.kp), abs(gains.ki) * dt
    pole = 1.0 if math.isinf(process.lag) else math.exp(-1.0 / process.lag)
    rate = process.gain * (1.0 if math.isinf(process.lag) else 1.0 - pole)
    other = 0.0
    seconds = [shape.second for shape in shapes() if shape.lag == process.lag]
    if process.second:
        other = math.exp(-1.0 / seconds[process.second])
    whole = max(round(process.dead), 0)
    n = len(setpoint)
    pv, co = np.zeros(n), np.zeros(n)
    first = last = total = 0.0
    for i in range(n):
        pv[i] = last
        error = float(setpoint[i]) - last
        total += ki * error
        co[i] = kp * error + total
        moved = co[i - whole] if i >= whole else 0.0
        first = pole * first + rate * moved
        last = other * last + (1.0 - other) * first
    return pv, co


def _settling(odds: TuningOdds, process: _Process) -> int:
    """Samples until the loop stays within SETTLED of a step, in the bounds of a hold."""
    pv, _ = _closed_loop(odds, process, np.ones(LONGEST))
    away = np.flatnonzero(np.abs(pv - 1.0) > SETTLED)
    return min(max(int(away[-1]) + 1 if len(away) else SHORTEST, SHORTEST), LONGEST)


def _energies(
    odds: TuningOdds, true: _Process, groups: Sequence[Sequence[_Process]], hold: int, load: LoadModel
) -> list[float]:
    """D for a step of s between one process and the nearest of each class (infinite for its own)."""
    setpoint = np.concatenate([np.ones(hold), np.zeros(hold)])
    _, co = _closed_loop(odds, true, setpoint)
    pv = _answer(true, co)
    white = impulse_response(load.a, load.c, len(pv))
    found = []
    for group in groups:
        if group[0].kind == true.kind:
            found.append(math.inf)
            continue
        apart = filtered(spectrum(np.array([pv - _answer(other, co) for other in group])), len(pv), white)
        found.append(min(float(d @ d) for d in apart))
    return found


def _decides(energy: FloatArray, weight: FloatArray) -> float:
    """P(decides) of the head of this file. energy : D, shape (classes, classes), infinite on the diagonal."""
    share = 0.0
    for i, p in enumerate(weight):
        others = [j for j in range(len(weight)) if j != i]
        reached = [_reaches(float(energy[i, j]), math.log(p / weight[j])) for j in others]
        share += float(p) * min(reached, default=1.0)
    return share


def _reaches(energy: float, lead: float) -> float:
    """Probability that the tempered ratio, with what leads already, comes out at DECIDED."""
    mean = energy / (2 * T_SETPOINT) + lead - DECIDED
    spread = math.sqrt(max(energy, 1e-9) / T_SETPOINT)
    return 0.5 * (1.0 + math.erf(mean / spread / math.sqrt(2.0)))


def _rounded(size: float) -> float:
    """The size to two digits, upwards: people set such steps."""
    if not size > 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(size)) - 1)
    return math.ceil(size / unit - 1e-9) * unit
