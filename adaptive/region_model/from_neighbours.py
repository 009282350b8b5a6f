"""A region without evidence borrows the process of the others along the curves through them, never their gains.

What is borrowed is a prior (region_curves.py): of the fit of the region's first record, behind the same gate that
guards any region model, and of a proposal, which the guard proves on the whole spread. It counts no records of its own,
and is never passed on.
"""

from collections.abc import Mapping

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.identification.estimate import spread
from retuner.adaptive.region_model.region_curves import centre_of, curves, lenders
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import Agreement, Learned, TrackerSettings
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.regions import Regions


@dataclass(frozen=True, slots=True)
class BorrowingSettings:
    """Settings of what a region borrows from its neighbours. Raises ValueError: one is outside its range."""

    most_lead: float = setting(12.0, "Evidence by which a borrowed structure leads at the most", "0.. nats")
    # its own responses tell more than its neighbours
    far_off: float = setting(
        0.6, "IAE after over before, as predicted, up to which gains change before any response; 0: never", "0..1"
    )

    def __post_init__(self) -> None:
        require_in_range(self, "borrowing")


def borrowed(
    region_models: Mapping[int, RegionModel],
    region: int,
    regions: Regions,
    t_s: float,
    sign: int,
    settings: BorrowingSettings,
    tracker: TrackerSettings,
    own: RegionModel | None = None,
) -> RegionModel | None:
    """What may be assumed of a region's process from the others, None where none knows its own.

    region_models : by region, from records of their own. region : index of the one without.
    t_s : now. sign : of the process gain there, from the controller's direction. own : what its own records say, too
        little for settings alone; the curves go through it as well.
    """
    near = {i: model for i, model in lenders(region_models, sign).items() if i != region}
    if not near:
        return None
    # How far each structure lies behind the leading ones; the nearer a region, the more it counts
    weights = {other: 1 / regions.distance(region, other) for other in near}
    total = sum(weights.values())
    types = set.intersection(*({k.log.type for k in model.known} for model in near.values()))
    behind = dict.fromkeys(types, 0.0)
    for other, model in near.items():
        for k in model.known:
            if k.log.type in types:
                lead = min(max(k.evidence - model.known[0].evidence, 0.0), settings.most_lead)
                behind[k.log.type] += weights[other] / total * lead
    shown = {region: own} if own is not None and own.log.sign == sign else {}
    through = curves({**near, **shown}, regions, t_s, tracker)
    place = centre_of(regions, region)
    known = [StructureModel(curve.log(place, sign, t), behind[t]) for t, curve in through.items() if t in behind]
    if not known:
        return None
    ranked = sorted(known, key=lambda k: k.evidence)
    names = ", ".join(regions.names[other] for other in sorted(near))
    log = ranked[0].log
    return RegionModel(
        tuple(ranked), 0, t_s, None, (), spread(log), identifiable=True, reason=f"estimated from other regions: {names}"
    )


def as_wide_as_known(learned: Learned) -> Learned:
    """What was learned, and a proposal from it proved on the whole covariance of the region as well.

    What the last record allows by itself is as narrow as a linear model of it claims.
    """
    model = learned.region_model
    if model is None or learned.agreement in {Agreement.SILENT, Agreement.CONTRADICTS}:
        return learned
    return replace(learned, region_model=replace(model, plausible=(*model.plausible, *spread(model.log)[1:])))
