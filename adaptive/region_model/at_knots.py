"""What is known of the process at the knots of an interpolated table.

A region's model is that of the places where its records were. A knot's gains run alone at the knot only, and they have
to suit the process there. So a model is carried along the curves through all regions (region_curves.py):

    ln p(knot)  =  ln p(records)  +  s,      s ~ N(the step of the curves, its covariance)

With one region known nobody knows the slope: the model stays and opens with the distance, as the curves' prior says.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.structure import model_at, parameters_of
from retuner.adaptive.identification.estimate import MOST_LOG_STEP, LogModel, proper_covariance
from retuner.adaptive.identification.plausible import OUT, Plausible
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.region_curves import (
    Place,
    RegionCurves,
    centre_of,
    curves,
    lenders,
    open_curves,
    place_of_records,
)
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.regions import Regions

Step = tuple[FloatArray, FloatArray]  # step of the logarithms from the records to the knot, and its covariance


def at_knots(
    region_models: Mapping[int, RegionModel], regions: Regions, t_s: float, tracker: TrackerSettings
) -> dict[int, RegionModel]:
    """The models as they are at the centres of their regions; what is borrowed is so already.

    region_models : by region. t_s : now.
    """
    found = dict(region_models)
    for region, model in region_models.items():
        if model.records:
            lent = lenders(region_models, model.log.sign)
            through = curves(lent, regions, t_s, tracker, of_records=True)
            found[region] = carried(model, regions, through, place_of_records(model, regions, region), region)
    return found


def carried(
    model: RegionModel, regions: Regions, through: Mapping[ProcessType, RegionCurves], here: Place, region: int
) -> RegionModel:
    """A model carried from a place to the centre of its region."""
    there = centre_of(regions, region)
    if here == there:
        return model
    steps: dict[ProcessType, Step] = {}
    known = []
    for one in model.known:
        log = one.log
        curve = through.get(log.type) or open_curves(regions, len(log.x))
        x, p = steps[log.type] = curve.step(here, there)
        known.append(replace(one, log=LogModel(log.x + x, proper_covariance(log.p + p), log.sign, log.type)))
    return replace(model, known=tuple(known), plausible=_plausible(model, steps))


def _plausible(model: RegionModel, steps: Mapping[ProcessType, Step]) -> tuple[Plausible, ...]:
    """The allowed models carried along, and the best one as far beside as the step is unsure."""
    sign, found = model.log.sign, []
    for one in model.plausible:
        step = steps.get(one.model.type)
        x = parameters_of(one.model) + step[0] if step is not None else None
        found.append(one if x is None else Plausible(model_at(one.model.type, x, sign), one.excess))
    mean, p = steps[model.log.type]
    values, vectors = np.linalg.eigh(p)
    way = OUT * vectors[:, -1] * np.sqrt(max(float(values[-1]), 0.0))
    way = way * min(1.0, MOST_LOG_STEP / max(float(np.max(np.abs(way))), MOST_LOG_STEP))
    for side in (1.0, -1.0):
        beside = model_at(model.log.type, model.log.x + mean + side * way, sign)
        found.append(Plausible(beside, OUT**2))
    return tuple(found)
