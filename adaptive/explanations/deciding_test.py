"""The test that would settle what a record leaves open: the smallest setpoint step out and back, and its odds.

    D_ij = sum over the test of [A/C (pv_i - x_j)]^2 / s^2          pv_i: process i under the test; x_j: j under i's co
    l_i  = ln sum P_j e^(-D_ij / 2T) over i's class  -  the same over all others
    P(decides) = sum_i P_i Phi((l_i - ln 9) / sqrt(D_ir / T))       r: the likeliest rival of another class

A valve that may stay behind co is told by steps of co in manual: D is then between the process's answer and none.

Processes are drawn from the odds (settings_by_odds.py). D/2 is the mean of the log-likelihood ratio of two of them
under the load and noise that the record has shown (A/C and s, wandering_load.py), T the temper of a setpoint's doing,
and the ratio is normal with variance D. The test decides where the odds come out at nine to one or more. No test tells
a process at the boundary of its class from its neighbour: such a one counts as often as it is likely, and no more.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.explanations.likely_processes import quantile
from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, gain_unit, shapes
from retuner.adaptive.explanations.proposed_test import DecidingTest, TestKind
from retuner.adaptive.explanations.settings_by_odds import likely_processes
from retuner.adaptive.explanations.tuning_odds import TuningLimits, TuningOdds, class_of
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

SIZES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
"""Sizes tried, in standard deviations of pv's deviation from its setpoint."""
ENOUGH_TO_DECIDE, LEAST_TO_DECIDE = 0.8, 0.25
"""The smallest step with the first probability to decide is proposed; where none has it, the largest, if it has the
second: a test that decides next to nothing only upsets a plant. (With a half, three loops far too slow had no test.)"""
DECIDED = math.log(9.0)  # odds that decide
DRAWN = 32  # processes that stand for all
LONG_ENOUGH = 0.8  # share of them that settle while a step is held
SHORTEST, LONGEST = 30, 250  # samples that the step is held
SETTLED = 0.05


def deciding_test(
    odds: TuningOdds, record: Prepared, error_std: float, room: float = math.inf, least: float = 0.0
) -> DecidingTest | None:
    """The smallest setpoint step that is likely to decide; None where none is.

    error_std : standard deviation of pv from its setpoint, pv units. room : how far co can go, which half of the
    processes do not exceed. least : size below which none is proposed, in standard deviations.
    """
    load, std = _load(odds, record)
    drawn, weight, kinds = _drawn(odds)
    hold = _hold(odds, drawn, weight)
    setpoint = np.concatenate([np.ones(hold), np.zeros(hold)])
    co = np.array([_closed_loop(odds, true, setpoint)[1] for true in drawn])
    energy = _energies(drawn, co, load) * (error_std / std) ** 2
    decides = [_decides(energy * size**2, weight, kinds) for size in SIZES]
    most = room / quantile(np.max(np.abs(co), axis=1), weight, 0.5)
    return _smallest(TestKind.SETPOINT, error_std, hold * odds.sample_time_s, decides, most, least)


def valve_test(odds: TuningOdds, record: Prepared, co_std: float, room: float = math.inf) -> DecidingTest | None:
    """The smallest steps of co in manual at which a pv that follows is told from one behind a valve that stays.

    A pv that follows shows D of the head of this file between the process's answer and none; a valve that stays shows
    none. co_std : standard deviation of co in the record, co units. room : how far co can go up.
    """
    load, std = _load(odds, record)
    group, weight, _ = _drawn(odds)
    hold = min(_hold(odds, group, weight), LONGEST // 2)
    co = np.concatenate([np.full(hold, level) for level in (1.0, 2.0, 1.0, 0.0)])
    white = impulse_response(load.a, load.c, len(co))
    shown = [filtered(spectrum(_answer(process, co)), len(co), white) for process in group]
    energy = np.array([float(d @ d) for d in shown]) * (co_std / std) ** 2
    decides = [float(weight @ _reaches(energy * size**2, energy * size**2 / (2 * T_SETPOINT))) for size in SIZES]
    return _smallest(TestKind.VALVE, co_std, hold * odds.sample_time_s, decides, room / 2.0)


def _smallest(
    kind: TestKind, std: float, hold_s: float, decides: Sequence[float], most: float, least: float = 0.0
) -> DecidingTest | None:
    """The smallest test that is likely to decide. std : what SIZES count. decides : the probability at each of them.
    most : largest size, in units. least : smallest one, in std.
    """
    possible = [share for size, share in zip(SIZES, decides, strict=True) if size * std <= most]
    at = next((i for i, share in enumerate(possible) if share >= ENOUGH_TO_DECIDE), len(possible) - 1)
    if not possible or possible[at] < LEAST_TO_DECIDE:
        return None
    size, unit = min(max(SIZES[at], least) * std, most), 0.0
    if size > 0:  # to two digits, upwards where there is room: people set such steps
        unit = 10.0 ** (math.floor(math.log10(size)) - 1)
        up = math.ceil(size / unit - 1e-9) * unit
        size = up if up <= most else math.floor(size / unit + 1e-9) * unit
    return DecidingTest(kind, size if unit else 0.0, hold_s, decides[at])


@dataclass(frozen=True, slots=True)
class _Process:
    """A process of the grid: first and second lag, dead time, gain; in samples."""

    lag: float
    second: int
    dead: float
    gain: float


def _drawn(odds: TuningOdds) -> tuple[list[_Process], FloatArray, FloatArray]:
    """Processes that stand for all on which the loop is stable, their odds, and the class of each."""
    likely = likely_processes(odds, DRAWN)
    classes = class_of(odds.robustness, odds.gains, odds.sample_time_s, TuningLimits())
    unit, every = gain_unit(odds.gains, odds.sample_time_s) / odds.robustness.scale, shapes()
    stable = np.array([bool(np.isfinite(odds.robustness.ms[at])) for at in likely.index])
    kept = np.flatnonzero(stable if stable.any() else ~stable)
    found = []
    for i, j, k in (likely.index[at] for at in kept):
        second = sum(other.lag == every[i].lag for other in every[:i])
        found.append(_Process(every[i].lag, second, DEAD_TIMES[j], float(GAINS[k]) * every[i].unit / unit))
    weight = likely.weights[kept] / float(likely.weights[kept].sum())
    return found, weight, np.array([classes[likely.index[at]] for at in kept])


def _hold(odds: TuningOdds, drawn: Sequence[_Process], weight: FloatArray) -> int:
    """Samples in which most of these loops stay within SETTLED of a step, in the bounds of a hold."""
    settled = []
    for process in drawn:
        away = np.flatnonzero(np.abs(_closed_loop(odds, process, np.ones(LONGEST))[0] - 1.0) > SETTLED)
        settled.append(float(min(max(int(away[-1]) + 1 if len(away) else SHORTEST, SHORTEST), LONGEST)))
    return round(quantile(np.array(settled), weight, LONG_ENOUGH))


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
    pv, co = list[float](), list[float]()
    first = last = total = 0.0
    for i, wanted in enumerate(setpoint.tolist()):
        pv.append(last)
        total += ki * (wanted - last)
        co.append(kp * (wanted - last) + total)
        moved = co[i - whole] if i >= whole else 0.0
        first = pole * first + rate * moved
        last = other * last + (1.0 - other) * first
    return np.array(pv), np.array(co)


def _energies(drawn: Sequence[_Process], co: FloatArray, load: LoadModel) -> FloatArray:
    """D for a step of s out and back, of each process that is true under its own co: shape (true, processes)."""
    n, impulse = co.shape[1], np.append(1.0, np.zeros(co.shape[1] - 1))
    passed = spectrum(filtered(spectrum(co), n, impulse_response(load.a, load.c, n)))
    answers = np.array([filtered(passed, n, _answer(process, impulse)) for process in drawn])
    own = answers[np.arange(len(drawn)), np.arange(len(drawn))]
    return np.array([np.einsum("ij,ij->i", apart, apart) for apart in own - answers]).T


def _decides(energy: FloatArray, weight: FloatArray, kinds: FloatArray) -> float:
    """P(decides) of the head of this file. energy : D, shape (processes, processes). kinds : the class of each."""
    likelihood = np.log(weight) - energy / (2 * T_SETPOINT)
    own = kinds[:, None] == kinds
    if own.all():
        return 1.0
    rivals = np.where(own, -np.inf, likelihood)
    lead = np.logaddexp.reduce(np.where(own, likelihood, -np.inf), axis=1) - np.logaddexp.reduce(rivals, axis=1)
    nearest = energy[np.arange(len(kinds)), np.argmax(rivals, axis=1)]
    return float(weight @ _reaches(nearest, lead))


def _reaches(energy: FloatArray, lead: FloatArray) -> FloatArray:
    """Probability that a tempered ratio with this mean comes out at DECIDED. energy : D."""
    far = (lead - DECIDED) / np.sqrt(np.maximum(energy, 1e-9) / T_SETPOINT)
    return np.array([0.5 * (1.0 + math.erf(float(one) / math.sqrt(2.0))) for one in far])
