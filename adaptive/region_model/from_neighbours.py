"""A region without evidence borrows the model of its neighbours, never their gains, and says so.

    x = sum_i w_i x_i,   P = sum_i w_i (P_i + d_i b^2 + (x_i - x)(x_i - x)'),   w_i ~ 1 / d_i

x_i, P_i are the neighbours' logarithms and covariances as they may be met now (aged by the random walk), d_i the number
of borders between, b the scatter from region to region: the mean and covariance of the mixture, so neighbours that
differ leave the region between them open. What is borrowed is a prior: of the fit of the region's first record, behind
the same gate that guards any region model, and of a proposal, which the guard proves on the whole spread. It counts no
records of its own and is never passed on.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.fit.structure import model_at
from retuner.adaptive.identification.estimate import LogModel, proper_covariance
from retuner.adaptive.identification.plausible import OUT, Plausible
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import TrackerSettings, predicted_all
from retuner.schedule.regions import Regions

MOST_LOG_STEP = math.log(2.0)
"""Farthest that a borrowed model lies from its mean in any log-parameter: beyond, a Gaussian says nothing."""


@dataclass(frozen=True, slots=True)
class BorrowingSettings:
    """Settings.

    between : how much the logarithms differ from one region to the next, one standard deviation; 0.1 to 1, default 0.4
        (a factor of 1.5; a process whose gain varies by four over three regions has 0.7 between two of them).
    farthest : borders between a region and one it borrows from; 1 to 3, default 1.
    most_lead : evidence by which a borrowed structure leads at the most; default 12.
    """

    between: float = 0.4
    farthest: int = 1
    most_lead: float = 12.0

    def __post_init__(self) -> None:
        if not 0 < self.between < math.inf or self.farthest < 1 or not self.most_lead >= 0:
            raise ValueError(f"{self}: between and farthest must be positive, most_lead 0 or more")


def borrowed(
    region_models: Mapping[int, RegionModel],
    region: int,
    regions: Regions,
    t_s: float,
    sign: int,
    settings: BorrowingSettings,
    tracker: TrackerSettings,
) -> RegionModel | None:
    """What may be assumed of a region's process from its neighbours', None where no neighbour knows its own.

    Parameters
    ----------
    region_models : by region, from records of their own. region : index of the one without.
    t_s : now. sign : of the process gain there, from the controller's direction.
    """
    near = {
        other: regions.distance(region, other)
        for other, region_model in region_models.items()
        if other != region and region_model.records and region_model.identifiable and region_model.log.sign == sign
    }
    near = {other: d for other, d in near.items() if d <= settings.farthest}
    if not near:
        return None
    weights = {other: 1 / d for other, d in near.items()}
    near_logs = {other: {log.type: log for log in predicted_all(region_models[other], t_s, tracker)} for other in near}
    types = set.intersection(*(set(logs) for logs in near_logs.values()))
    known = [_mixed(t, near, weights, near_logs, region_models, settings) for t in ProcessType if t in types]
    if not known:
        return None
    ranked = sorted(known, key=lambda k: k.evidence)
    names = ", ".join(regions.names[other] for other in sorted(near))
    log = ranked[0].log
    return RegionModel(
        tuple(ranked),
        0,
        t_s,
        None,
        (),
        spread(log),
        identifiable=True,
        reason=f"estimated from neighbouring regions: {names}",
    )


def _mixed(
    type_: ProcessType,
    near: Mapping[int, int],
    weights: Mapping[int, float],
    near_logs: Mapping[int, Mapping[ProcessType, LogModel]],
    region_models: Mapping[int, RegionModel],
    settings: BorrowingSettings,
) -> StructureModel:
    """One structure of the mixture, and how far it lies behind the leading ones."""
    total = sum(weights.values())
    logs = {other: near_logs[other][type_] for other in near}
    share = {other: weights[other] / total for other in near}
    x = sum((share[o] * log.x for o, log in logs.items()), np.zeros(len(next(iter(logs.values())).x)))
    p = np.zeros((len(x), len(x)))
    for other, log in logs.items():
        apart = log.x - x
        p += share[other] * (log.p + near[other] * settings.between**2 * np.eye(len(x)) + np.outer(apart, apart))
    behind = 0.0
    for other in near:
        evidence = {k.log.type: k.evidence for k in region_models[other].known}
        lead = evidence[type_] - evidence[region_models[other].log.type]
        behind += share[other] * min(max(lead, 0.0), settings.most_lead)
    first = next(iter(logs.values()))
    return StructureModel(LogModel(x, proper_covariance(p), first.sign, type_), behind)


def spread(log: LogModel) -> tuple[Plausible, ...]:
    """The mean and both ends of every principal axis of the covariance, for the proof of what rests on nothing else."""
    values, vectors = np.linalg.eigh(log.p)
    axes = OUT * vectors * np.sqrt(np.maximum(values, 0.0))
    axes = axes * np.minimum(1.0, MOST_LOG_STEP / np.maximum(np.max(np.abs(axes), axis=0), MOST_LOG_STEP))
    ends = [log.x + side * axes[:, j] for j in range(len(log.x)) for side in (1.0, -1.0)]
    best = Plausible(model_at(log.type, log.x, log.sign), 0.0)
    return (best, *(Plausible(model_at(log.type, x, log.sign), OUT**2) for x in ends))
