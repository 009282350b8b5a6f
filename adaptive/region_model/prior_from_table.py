"""What the table itself says of a region that nobody has watched: its set is as right there as others are.

    process of region r = process of region i,  its gain times Kc_i / Kc_r,  its times times tau_I_r / tau_I_i

On it the set of r does exactly what that of i does in i, in its own time: a hypothesis a region i that knows its
process. Curves through the regions (region_curves.py) do not know of a jump between them. Whoever drew up the table may
have, or may have been mistaken in one region only: where some of its sets turned out right, this one may be. So gains
for a region that nobody has watched must be right on these processes too. Where all known sets were wrong in the same
way, they agree with the curves.

The sets are those of the table as it was at first: what has been tuned since says nothing of the others.
"""

import math
from collections.abc import Mapping, Sequence

from retuner.adaptive.fit.structure import SLOPE, model_at
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.region_model.region_curves import lenders
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import TrackerSettings, predicted
from retuner.schedule.gains import PidGains


def as_right_as_others(
    region_models: Mapping[int, RegionModel],
    region: int,
    first: Sequence[PidGains],
    t_s: float,
    tracker: TrackerSettings,
) -> tuple[Plausible, ...]:
    """The processes of a region with which its set would be as right as the sets of the others are, one for each that
    knows its own; none where a set has no proportional gain.

    Parameters
    ----------
    region_models : by region. region : the one that nobody has watched. first : the table's sets as they were at first.
    t_s : now.
    """
    own, found = first[region], []
    for other, model in lenders(region_models, own.direction).items():
        theirs = first[other]
        if other == region or not own.kp or not theirs.kp:
            continue
        log = predicted(model, t_s, tracker)
        slower = math.log(1.0 if not theirs.ki or not own.ki else (own.kp / own.ki) / (theirs.kp / theirs.ki))
        x = log.x + slower
        x[SLOPE] = log.x[SLOPE] + math.log(theirs.kp / own.kp) - slower
        found.append(Plausible(model_at(log.type, x, log.sign), 0.0))
    return tuple(found)
