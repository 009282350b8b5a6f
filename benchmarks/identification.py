"""How often is a process identified well enough to tune it? Counts over records drawn from a seed.

    python benchmarks/identification.py [--seed 1] [--cases 260] [--jobs 1] [--only "setpoint"] [--save-failures FOLDER]

In spec: the SIMC settings that follow from the estimate meet, on the true process, Ms <= max(1.8, 1.03 x the Ms of SIMC
with perfect knowledge) and J <= 1.25 x its J (mean of the IAE ratios of a setpoint and a load step). "Not identifiable"
is counted apart. Calibration: where the structure is right, how often the truth lies within two standard deviations.
Seeds from 1000 on are for final measurements, not for development.
"""

import argparse
import functools
import json
import math
import statistics
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from cases import identification
from cases.case import FloatArray, picture, share, spread
from cases.loop import performance
from cases.plant import HeldPlant, half_rule, later, simc_of
from cases.setting import IdentificationCase, Loop

from retuner import LinearProcess, PidGains, identify

MS_LIMIT, MS_OVER_BEST, J_LIMIT = 1.8, 1.03, 1.25
TWO_SIGMA = 2.0
KNOWN = 0.25  # Standard deviation of ln Kc with which settings may come out in spec
STRUCTURES = {
    "first": "fopdt",
    "second": "sopdt",
    "integrating": "integrating",
    "integrating-lag": "integrating-lag",
    "batch-p6": "integrating-lag",
    "batch-p7": "sopdt",
}
"""Families whose structure a model can have exactly."""


class Score(NamedTuple):
    """One case scored; outcome is one of OUTCOMES."""

    index: int
    group: str
    family: str
    outcome: str
    ms: float
    j: float
    kc_error: float
    kc_known: float
    bound: float
    structure: str
    z: dict[str, float]
    seconds: float
    samples: int
    reason: str


OUTCOMES = ("in spec", "not identifiable", "Ms", "J", "unstable", "refused")


def best_of(loop: Loop, gains: PidGains) -> PidGains:
    """SIMC with perfect knowledge, of the actions that these have."""
    return loop.best_pid if gains.kd and loop.best_pid is not None else loop.best


def judged(loop: Loop, gains: PidGains) -> tuple[str, float, float]:
    """Outcome, Ms and J of settings on the true process."""
    best, ms = best_of(loop, gains), loop.margins(gains).ms
    if not math.isfinite(ms):
        return "unstable", ms, math.inf
    j = performance(loop.process, gains, best, loop.theta_s, loop.dt_s)
    if ms > max(MS_LIMIT, MS_OVER_BEST * loop.margins(best).ms):
        return "Ms", ms, j
    return ("in spec" if j <= J_LIMIT else "J"), ms, j


def z_scores(case: IdentificationCase, found: dict[str, object]) -> dict[str, float]:
    """Error over standard deviation of every parameter, where the structure is right."""
    model, std = found["model"], found["std"]
    if not isinstance(model, dict) or not isinstance(std, dict) or STRUCTURES.get(case.loop.family) != model["type"]:
        return {}
    lags = sorted(case.loop.process.lags_s, reverse=True)
    truth = {"k": case.loop.process.k, "theta": case.loop.process.theta_s}
    truth |= (
        {"tau2": lags[0]} if case.loop.process.integrators and lags else dict(zip(("tau1", "tau2"), lags, strict=False))
    )
    return {key: (model[key] - truth[key]) / std[key] for key in truth if std.get(key)}


def score(seed: int, group: str | None, folder: str | None, bounds: bool, index: int) -> Score:
    """Draw one case, identify it, judge what follows."""
    case = identification.case(seed, index, group)
    record = case.record
    begun = time.process_time()
    ms = j = kc_error = kc_known = math.nan
    z: dict[str, float] = {}
    structure = ""
    try:
        result = identify(
            *record, open_loop=case.gains is None, gains=case.gains, co_min=case.loop.low, co_max=case.loop.high
        )
    except ValueError as error:
        outcome, reason, seconds = "refused", str(error), time.process_time() - begun
    else:
        seconds, reason = time.process_time() - begun, result.estimate.reason
        outcome = "not identifiable"
        structure = str(result.estimate.log.model().type)
        if result.estimate.identifiable and result.settings is not None:
            gains = (result.aim or result.settings).tuning.gains  # what the record was found to ask for in the end
            outcome, ms, j = judged(case.loop, gains)
            ratio = gains.kp / best_of(case.loop, gains).kp
            kc_error = abs(math.log(ratio)) if ratio > 0 else math.inf
            z = z_scores(case, result.estimate.to_dict())
            # |ln Kc / best| by the same rule from the model alone: the error of the estimate, whatever rule follows
            reduced = later(half_rule(result.estimate.log.model().linear()), case.loop.dt_s / 2)
            ratio = simc_of(reduced, reduced.theta_s).kp / case.loop.best.kp
            kc_known = abs(math.log(ratio)) if ratio > 0 else math.inf
    bound = kc_bound(case) if bounds and STRUCTURES.get(case.loop.family) == structure else math.nan
    if folder and outcome != "in spec":
        _picture(case, outcome, ms, j, reason, Path(folder))
    return Score(
        index,
        case.group,
        case.loop.family,
        outcome,
        ms,
        j,
        kc_error,
        kc_known,
        bound,
        structure,
        z,
        seconds,
        len(record.t),
        reason,
    )


def _picture(case: IdentificationCase, outcome: str, ms: float, j: float, reason: str, folder: Path) -> None:
    """The record of a failure with the truth."""
    p, m = case.loop.process, half_rule(case.loop.process)
    title = (
        f"{case.group} / {case.loop.family}, case {case.index}: {outcome}, Ms {ms:.2f}, J {j:.2f}\n{reason}\n"
        f"true k {p.k:.4g} lags {_few(p.lags_s)} leads {_few(p.leads_s)} pairs {p.quadratics} theta {p.theta_s:.4g} "
        f"integrators {p.integrators}; half rule theta {m.theta_s:.4g} tau1 {m.tau1_s:.4g}; noise {case.noise:.3g}"
    )
    picture(case.record, title, folder / f"{case.group.replace(' ', '_')}-{case.index}-{case.loop.family}.png")


def _few(values: Iterable[float]) -> str:
    return " ".join(f"{x:.4g}" for x in values) or "none"


# ---- The Cramer-Rao bound of ln Kc: how well any unbiased estimator could know the controller gain from a record.
#
# The Fisher information of the true structure under white noise, with the recorded co as input (in closed loop this is
# the prediction-error information: what co owes to past noise is known). Unknown besides the process are the bias, the
# size and place of every load step, and for an integrating process the resting input.

PLAIN = frozenset({"open-loop step", "open-loop steps", "setpoint", "load", "setpoint and load", "several", "pid"})
"""Groups with nothing but steps and white noise."""
STEP = 1e-4


def kc_bound(case: IdentificationCase) -> float:
    """Smallest standard deviation of ln Kc; NaN where a record has more unknowns than are modelled here."""
    if case.group not in PLAIN or case.note.get("drift"):
        return math.nan
    t = case.record.t
    n, dt = len(t), case.loop.dt_s
    loads = [(case.note[f"load_at{i}"], case.note[f"load{i}"]) for i in range(int(case.note.get("loads", 0)))]
    theta = np.array([0.0] * _free(case.loop.process) + [0.0, 0.0] * len(loads))
    scale = float(np.ptp(case.record.pv))

    def output(p: FloatArray) -> FloatArray:
        process = _moved(case.loop.process, p)
        u = case.record.co - case.record.co[0]
        for i, (at, size) in enumerate(loads):
            shift, stretch = p[_free(case.loop.process) + 2 * i : _free(case.loop.process) + 2 * i + 2]
            u = u + size * (1 + stretch) * np.clip(np.arange(n) + 1 - at - shift, 0, 1)
        plant = HeldPlant(process, dt)
        return np.array([0.0, *(plant.move(float(x)) for x in u[:-1])])

    columns = [np.ones(n) * scale]
    if case.loop.process.integrators:
        columns.append(np.arange(n) * scale / n)
    base = np.eye(len(theta)) * STEP
    columns += [(output(theta + e) - output(theta - e)) / (2 * STEP) for e in base]
    jacobian = np.column_stack(columns) / case.noise
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0  # the logarithm of a dead time of zero
    covariance = np.linalg.pinv((jacobian / size).T @ (jacobian / size)) / np.outer(size, size)
    first = len(columns) - len(theta)
    free = slice(first, first + _free(case.loop.process))
    gradient = np.array(
        [
            (_ln_kc(_moved(case.loop.process, e), dt) - _ln_kc(_moved(case.loop.process, -e), dt)) / (2 * STEP)
            for e in np.eye(_free(case.loop.process)) * STEP
        ]
    )
    return float(math.sqrt(gradient @ covariance[free, free] @ gradient))


def _free(process: LinearProcess) -> int:
    """Number of process parameters: gain, dead time, lags."""
    return 2 + len(process.lags_s)


def _moved(process: LinearProcess, p: FloatArray) -> LinearProcess:
    """The process with its parameters' logarithms moved by p."""
    factor = np.exp(p[: _free(process)])
    lags = tuple(float(x * f) for x, f in zip(process.lags_s, factor[2:], strict=True))
    return replace(process, k=process.k * float(factor[0]), theta_s=process.theta_s * float(factor[1]), lags_s=lags)


def _ln_kc(process: LinearProcess, dt_s: float) -> float:
    """ln Kc of SIMC PI."""
    model = later(half_rule(process), dt_s / 2)
    return math.log(abs(simc_of(model, model.theta_s).kp))


# ---- Tables


def table(scores: list[Score], by: str) -> list[str]:
    """A line a group or family: counts of outcomes, worst Ms, median error of Kc."""
    lines = [f"{by:<20}{'n':>5}" + "".join(f"{o:>17}" for o in OUTCOMES) + f"{'worst Ms':>10}{'|ln Kc/best|':>14}"]
    for name in sorted({getattr(s, by) for s in scores}):
        rows = [s for s in scores if getattr(s, by) == name]
        counts = "".join(f"{sum(s.outcome == o for s in rows):>17}" for o in OUTCOMES)
        lines.append(f"{name:<20}{len(rows):>5}{counts}{_worst(rows):>10.2f}{_median(s.kc_error for s in rows):>14.3f}")
    return lines


def _worst(scores: list[Score]) -> float:
    return max((s.ms for s in scores if not math.isnan(s.ms)), default=math.nan)


def _median(values: Iterable[float]) -> float:
    kept = [v for v in values if not math.isnan(v)]
    return statistics.median(kept) if kept else math.nan


def summary(scores: list[Score]) -> list[str]:
    n, given = len(scores), [s for s in scores if s.outcome not in {"not identifiable", "refused"}]
    good = sum(s.outcome == "in spec" for s in scores)
    z = [abs(value) for s in scores for value in s.z.values()]
    ratios = [s.kc_known / s.bound for s in given if s.bound > 0]
    lines = [
        f"in spec of all               {share(good, n)}",
        f"in spec where settings given {share(good, len(given))}",
        f"not identifiable or refused  {share(n - len(given), n)}",
        f"unstable                     {share(sum(s.outcome == 'unstable' for s in scores), n)}",
        f"worst Ms {_worst(scores):.2f}; median |ln Kc/best| {_median(s.kc_error for s in given):.3f}",
        f"truth within 2 sigma         {share(sum(v <= TWO_SIGMA for v in z), len(z))} (parameters, structure right)",
    ]
    for key in ("k", "tau1", "tau2", "theta"):
        of_key = [abs(s.z[key]) for s in scores if key in s.z]
        lines.append(f"  {key:<26} {share(sum(v <= TWO_SIGMA for v in of_key), len(of_key))}")
    right = [s for s in scores if s.family in STRUCTURES and s.structure]
    lines.append(
        f"structure as the truth's     {share(sum(STRUCTURES[s.family] == s.structure for s in right), len(right))}"
    )
    bounds = [s.bound for s in scores if not math.isnan(s.bound)]
    if bounds:
        lines.append(f"Cramer-Rao sigma of ln Kc under {KNOWN:g}  {share(sum(b < KNOWN for b in bounds), len(bounds))}")
    if ratios:
        middle = statistics.median(ratios)
        lines.append(f"|ln Kc error| over Cramer-Rao sigma: median {middle:.2f} of {len(ratios)} (efficient: 0.67)")
    per_call = [s.seconds for s in scores]
    per_1000 = [1000 * s.seconds / s.samples for s in scores]
    lines.append(
        f"CPU seconds a call: median {statistics.median(per_call):.3f}, largest {max(per_call):.3f}; "
        f"per 1000 samples: median {statistics.median(per_1000):.3f}"
    )
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=260, help="of all groups together, or of the one of --only")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", choices=(*identification.GROUPS, *identification.BY_NAME))
    parser.add_argument("--no-bounds", action="store_true", help="leave the Cramer-Rao bounds out")
    parser.add_argument("--save-failures", metavar="FOLDER")
    parser.add_argument("--out", metavar="FILE", help="every score as a line of JSON")
    options = parser.parse_args()
    work = functools.partial(score, options.seed, options.only, options.save_failures, not options.no_bounds)
    scores = list(spread(work, range(options.cases), options.jobs))
    lines = [f"seed {options.seed}, {len(scores)} cases", *summary(scores), "", *table(scores, "group"), ""]
    lines += [*table(scores, "family"), ""]
    lines += [
        f"{s.outcome:<16} {s.group} {s.index} {s.family}: Ms {s.ms:.2f} J {s.j:.2f} {s.structure}: {s.reason}"
        for s in sorted(scores, key=lambda s: (s.outcome, s.group))
        if s.outcome != "in spec"
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    if options.out:
        Path(options.out).write_text("".join(json.dumps(s._asdict()) + "\n" for s in scores), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
