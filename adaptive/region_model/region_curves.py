"""What the regions together say of the process between them: smooth curves over the scheduling variables.

    ln p(x) = c + phi(x) z,   z ~ N(0, I)      phi : level, slope and bends (record_stretches.py), of both axes
    x_i = ln p(place of region i) + e_i,   e_i ~ N(0, P_i)

Every region with records of its own is one observation of the curves, with its covariance P_i: at its centre, which it
stands for as one set of gains serves it all, or, where gains move with the place, where its records were. What
follows for z is linear regression with a normal prior (kriging, Matheron 1963; its equal, Wahba 1978), with all
parameters of a structure at once, because P_i couples them. The curves are constant, lines or bent: each by its
evidence, the mean of the three being what is known (nobody has to choose here, as a person does who draws up a
schedule). A neighbour says less the farther it is, and regions that differ open what lies between them.
"""

import math
from collections.abc import Mapping

import numpy as np

from retuner.adaptive.identification.estimate import LogModel, proper_covariance
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import TrackerSettings, predicted_all
from retuner.adaptive.schedule_design.record_stretches import CurveAxis, CurveShape
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.regions import Regions

Place = tuple[float, ...]  # A value on each axis of the table
OPEN = 0.2  # share that bent curves keep at least: equal regions do not prove that there is nothing between them


@dataclass(frozen=True, slots=True)
class RegionCurves:
    """One structure's parameters over the scheduling variables.

    axes : of the table. centre : c, shape (d,). z : mean, parameter by parameter, shape (d m,). p : covariance.
    """

    axes: tuple[CurveAxis, ...]
    centre: FloatArray
    z: FloatArray
    p: FloatArray

    def at(self, place: Place) -> tuple[FloatArray, FloatArray]:
        """The logarithms at a place and their covariance, shapes (d,) and (d, d)."""
        rows = _rows(self.axes, place, len(self.centre))
        return self.centre + rows @ self.z, rows @ self.p @ rows.T

    def step(self, here: Place, there: Place) -> tuple[FloatArray, FloatArray]:
        """The change of the logarithms from one place to another, and the covariance of that; shapes as `at`."""
        rows = _rows(self.axes, there, len(self.centre)) - _rows(self.axes, here, len(self.centre))
        return rows @ self.z, rows @ self.p @ rows.T

    def log(self, place: Place, sign: int, type_: ProcessType) -> LogModel:
        """The process at a place. sign : of its gain. type_ : the structure that these curves are of."""
        x, p = self.at(place)
        return LogModel(x, proper_covariance(p), sign, type_)


def centre_of(regions: Regions, region: int) -> Place:
    """Middle of a region on each axis."""
    return tuple(regions.centre(region, axis) for axis in range(len(regions.axes)))


def place_of_records(region_model: RegionModel, regions: Regions, region: int) -> Place:
    """Where on each axis the records of a region were, in the mean; its centre where none is remembered."""
    if not region_model.points:
        return centre_of(regions, region)
    where = np.mean([(point.x, point.x2) for point in region_model.points], axis=0)
    return tuple(min(max(float(x), axis.low), axis.high) for x, axis in zip(where, regions.axes, strict=False))


def open_curves(regions: Regions, d: int) -> RegionCurves:
    """The curves of d parameters before any record."""
    axes = tuple(CurveAxis(axis.low, axis.high) for axis in regions.axes)
    size = d * (1 + len(axes) * (int(CurveShape.BENT) - 1))  # a level, and slope and bends along every axis
    return RegionCurves(axes, np.zeros(d), np.zeros(size), np.eye(size))


def lenders(region_models: Mapping[int, RegionModel], sign: int) -> dict[int, RegionModel]:
    """The regions that know their process from records of their own. sign : of the process gain."""
    return {
        i: model
        for i, model in region_models.items()
        if model.records and model.identifiable and model.log.sign == sign
    }


def curves(
    region_models: Mapping[int, RegionModel],
    regions: Regions,
    t_s: float,
    tracker: TrackerSettings,
    *,
    of_records: bool = False,
) -> dict[ProcessType, RegionCurves]:
    """The curves of every structure that all these regions have, none where there is no region.

    region_models : by region, as `lenders` gives them. t_s : now; what is known has aged until then. of_records : the
        models are of the places where their records were, and not of the centres.
    """
    logs = {i: {log.type: log for log in predicted_all(model, t_s, tracker)} for i, model in region_models.items()}
    if not logs:
        return {}
    types = set.intersection(*(set(known) for known in logs.values()))
    places = [place_of_records(region_models[i], regions, i) if of_records else centre_of(regions, i) for i in logs]
    return {t: _through(regions, places, [known[t] for known in logs.values()]) for t in ProcessType if t in types}


def _through(regions: Regions, places: list[Place], logs: list[LogModel]) -> RegionCurves:
    centre = np.mean([log.x for log in logs], axis=0)
    axes, d = tuple(CurveAxis(axis.low, axis.high) for axis in regions.axes), len(centre)
    rows = [_rows(axes, place, d) for place in places]
    size = rows[0].shape[1]
    precision, weighted = np.zeros((size, size)), np.zeros(size)
    for row, log in zip(rows, logs, strict=True):
        solved = np.linalg.solve(log.p, np.concatenate([row, (log.x - centre)[:, None]], axis=1))
        precision += row.T @ solved[:, :-1]
        weighted += row.T @ solved[:, -1]
    # z, its covariance, and ln of the evidence up to what is common to all, of each shape: only its own coefficients
    # may differ from zero
    more, m, shaped = int(CurveShape.BENT) - 1, size // d, []
    for shape in CurveShape:
        own = [0, *(1 + k * more + j for k in range(len(axes)) for j in range(int(shape) - 1))]
        kept = [i * m + j for i in range(d) for j in own]
        whole = np.eye(len(kept)) + precision[np.ix_(kept, kept)]
        z, p = np.zeros(size), np.zeros((size, size))
        inside = np.linalg.inv(whole)
        z[kept], p[np.ix_(kept, kept)] = inside @ weighted[kept], inside
        shaped.append((z, p, 0.5 * float(weighted[kept] @ z[kept] - np.linalg.slogdet(whole)[1])))
    best = max(evidence for _, _, evidence in shaped)
    shares = np.array([math.exp(evidence - best) for _, _, evidence in shaped])
    shares *= (1 - OPEN) / np.sum(shares)
    shares[-1] += OPEN
    mean = sum((share * z for share, (z, _, _) in zip(shares, shaped, strict=True)), np.zeros(size))
    spread = np.zeros((size, size))
    for share, (z, p, _) in zip(shares, shaped, strict=True):
        spread += share * (p + np.outer(z - mean, z - mean))
    return RegionCurves(axes, centre, mean, spread)


def _rows(axes: tuple[CurveAxis, ...], place: Place, d: int) -> FloatArray:
    """d ln p / dz at a place, shape (d, d m): the same for each of d parameters."""
    columns = [axis.columns(np.array(x), CurveShape.BENT) for axis, x in zip(axes, place, strict=True)]
    phi = np.concatenate([columns[0], *(more[1:] for more in columns[1:])])
    return np.kron(np.eye(d), phi)
