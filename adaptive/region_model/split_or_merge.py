"""What the records say of the regions themselves: one that holds two processes should be split, equal ones merged.

Both questions are put to what the models ask of their controller, z = (ln |Kc|, ln tau_I) with covariance C
(`features`): regions exist for the sake of settings.

Split. One region: the records by themselves, z_i at (x_i, t_i), scatter about a common mean, z_i ~ N(m, C_i + s^2 I)
with the scatter s between records that a region may have. Two: a boundary between two x, a mean on either side. With
chi2 = sum (z_i - m)' (C_i + s^2 I)^-1 (z_i - m) at the best m, the logarithm of the likelihood ratio is
(chi2_one - chi2_two)/2, and twice of it is chi-square with two degrees of freedom where there is one process (Wilks
1938): exceeded with probability alpha at -2 ln(alpha/n), n being the number of boundaries that were tried (Bonferroni).
A boundary is proposed when it passes that, when it leaves no contradiction behind, when it explains better than the
same split in time (a process that changed is no second region), and when the settings on its two sides differ by
enough.

Merge. Neighbours whose settings agree: the means of their records must place the ratio, with its uncertainty, within a
factor at which nobody would keep two sets. Regions with too few records are never merged. The uncertainty of a mean is
widened by what its records scatter beyond what they claim, chi2/(2 (n - 1)) where that is more than 1 (Birge 1932). On
a map of two axes a boundary runs through all rows or columns, and so does the proposal.

Whether a region's process suits one set is asked by proposed_boundaries.py; both are told at the end of a run
(left_by_run.py), and a person takes that one up with `retuner approve`. No boundary is moved on line:
schedule_choice/boundaries_of_{one_variable,two_variables}.py lay all of them out anew, for `retuner schedule`.

Pure: region models in, advice out; nothing is changed.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum

import numpy as np

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.identification.estimate import LogModel, proper_covariance
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import to_ideal
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values
from retuner.schedule.regions import Axis, Regions

# What a model asks of its controller, as two numbers with their covariance: (ln |Kc|, ln tau_I) of SIMC.
#
# Models of different structures cannot be compared by their parameters; the settings that follow from them can, and
# they are what a gain table is about. SIMC (Skogestad 2003, section 4) with tau_c = theta gives both; half a sampling
# interval is added to the delay, as everywhere on line. The covariance is that of the log-parameters, taken across one
# standard deviation either way.

SIZE = 2


@dataclass(frozen=True, slots=True)
class Features:
    """z : (ln |Kc|, ln tau_I in s), shape (2,). p : its covariance, shape (2, 2)."""

    z: FloatArray
    p: FloatArray


def features(log: LogModel, sample_time_s: float) -> Features:
    """The two numbers of an estimate. sample_time_s : the controller's sampling interval."""
    found = log.covariance_of(lambda model: _settings_by(model, sample_time_s))
    return Features(_settings_by(log.model(), sample_time_s), proper_covariance(found))


def _settings_by(found: ProcessModel, sample_time_s: float) -> FloatArray:
    """(ln |Kc|, ln tau_I) of a model; the gain is that of the ideal form, kp."""
    model = without_second_lag(found.seen_by_controller(sample_time_s))
    ideal = to_ideal(simc(model, model.theta_s).gains)
    assert ideal.tau_i_s is not None
    return np.array([math.log(abs(ideal.kc)), math.log(ideal.tau_i_s)])


class AdviceKind(StrEnum):
    """What is proposed."""

    SPLIT = "split"
    MERGE = "merge"


@dataclass(frozen=True, slots=True)
class AdviceSettings:
    """Settings. Raises ValueError: one is outside its range."""

    alpha: float = setting(0.001, "Probability at which one process is taken for two; it is only advice", "1e-6..0.05")
    scatter: float = setting(0.12, "Scatter of ln Kc and ln tau_I from record to record in a region", ">0..")
    against_time: float = setting(
        6.0, "Lead of a boundary over a change in time, in 2 ln of the likelihood; 6: odds of 20", "0.."
    )
    least_records: int = setting(3, "Records on each side of a boundary, and in each of two equal regions", "2..")
    split_factor: float = setting(1.5, "Least factor between the settings of the two sides", ">1..1e6")
    merge_factor: float = setting(
        1.25, "Largest factor between the settings of equal regions, its uncertainty included", ">1..1e6"
    )
    bound_std: float = setting(1.96, "Standard deviations that this uncertainty counts; 1.96: 95 %", ">0..")

    def __post_init__(self) -> None:
        require_in_range(self, "advice")


@dataclass(frozen=True, slots=True)
class RegionAdvice:
    """One proposal with its evidence.

    regions : names: the one to split, or all that become fewer. axis : label of the axis, with its unit. boundary :
    where on it. kc_factor, tau_i_factor : settings above the boundary over those below it. records : below, above.
    statistic, limit : twice the logarithm of the likelihood ratio of a boundary against none, and what it had to pass;
    of a merge the largest factor with its uncertainty, and its limit. against_time : the same against a change in time.
    """

    kind: AdviceKind
    regions: tuple[str, ...]
    axis: str
    unit: str
    boundary: float
    kc_factor: float
    tau_i_factor: float
    records: tuple[int, int]
    statistic: float
    limit: float
    against_time: float = 0.0

    @property
    def sentence(self) -> str:
        """The proposal in a sentence or two."""
        factors = f"Kc x {self.kc_factor:.2f}, tau_I x {self.tau_i_factor:.2f}"
        where = f"{self.axis} = {self.boundary:.4g} {self.unit}".rstrip()
        if self.kind is AdviceKind.MERGE:
            named = " and ".join(self.regions) if len(self.regions) == 2 else ", ".join(self.regions)
            return (
                f"The boundary at {where} may go: the records ask for the same settings on both sides of it in "
                f"{named} ({factors}; at most a factor of {self.statistic:.2f} with its uncertainty, "
                f"{self.limit:g} allowed)."
            )
        likelier, needed, later = (v / 2 / math.log(10) for v in (self.statistic, self.limit, self.against_time))
        return (
            f"Region {self.regions[0]} holds two processes: a boundary at {where} explains its records "
            f"10^{likelier:.1f} times better than one process (10^{needed:.1f} needed). It explains them "
            f"10^{later:.1f} times better than a change in time. Above it the records ask for {factors} "
            f"({self.records[0]} records below, {self.records[1]} above)."
        )

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        numbers = plain_values(self, "kc_factor tau_i_factor records statistic limit against_time sentence")
        return plain_values(self, "kind regions axis unit") | {"border": self.boundary} | numbers


def region_advice(
    regions: Regions, region_models: Mapping[int, RegionModel], sample_time_s: float, settings: AdviceSettings
) -> tuple[RegionAdvice, ...]:
    """All proposals: splits in the order of the regions, then merges in the order of the boundaries.

    regions : as they are. region_models : what is known, by region. sample_time_s : of the controller.
    """
    splits = (_split(regions, i, region_models[i].points, sample_time_s, settings) for i in sorted(region_models))
    return (
        *(advice for advice in splits if advice is not None),
        *_merges(regions, region_models, sample_time_s, settings),
    )


@dataclass(frozen=True, slots=True)
class _Side:
    """Records explained by one mean: their number, the mean with its covariance, what it leaves (chi-square)."""

    count: int
    mean: FloatArray
    p: FloatArray
    left: float


_Weighted = tuple[FloatArray, FloatArray]  # z of a record, and its weight matrix


def _side(points: Sequence[_Weighted]) -> _Side:
    """The best common mean of (z, weight matrix)."""
    total = np.sum([w for _, w in points], axis=0)
    mean = np.linalg.solve(total, np.sum([w @ z for z, w in points], axis=0))
    left = sum(float((z - mean) @ w @ (z - mean)) for z, w in points)
    spread = max(left / (SIZE * max(len(points) - 1, 1)), 1.0)
    return _Side(len(points), mean, np.asarray(np.linalg.inv(total) * spread, dtype=np.float64), left)


@dataclass(frozen=True, slots=True)
class _RecordCut:
    """Records parted at a place on an axis: the best of those that were tried."""

    boundary: float
    below: _Side
    above: _Side
    tried: int

    @property
    def left(self) -> float:
        """What both means together leave."""
        return self.below.left + self.above.left


def _weighted(points: Sequence[RecordPoint], sample_time_s: float, scatter: float) -> list[_Weighted]:
    """Each record's z, and the inverse of its covariance with the scatter."""
    found = [features(point.log, sample_time_s) for point in points]
    return [(f.z, np.asarray(np.linalg.inv(f.p + scatter**2 * np.eye(SIZE)), dtype=np.float64)) for f in found]


def _best_cut(points: Sequence[_Weighted], places: Sequence[float], least: int) -> _RecordCut | None:
    """The cut of ordered places that explains best; None where there is none with enough records on both sides."""
    order = np.argsort(places, kind="stable").tolist()
    cuts = []
    for n in range(least, len(order) - least + 1):
        low, high = places[order[n - 1]], places[order[n]]
        if low < high:
            below, above = _side([points[i] for i in order[:n]]), _side([points[i] for i in order[n:]])
            cuts.append(_RecordCut((low + high) / 2, below, above, 1))
    return replace(min(cuts, key=lambda cut: cut.left), tried=len(cuts)) if cuts else None


def _split(
    regions: Regions, region: int, points: Sequence[RecordPoint], sample_time_s: float, settings: AdviceSettings
) -> RegionAdvice | None:
    placed = [p for p in points if math.isfinite(p.x) and math.isfinite(p.x2)]
    if len(placed) < 2 * settings.least_records:
        return None
    weighted, least = _weighted(placed, sample_time_s, settings.scatter), settings.least_records
    cuts = [_best_cut(weighted, [(p.x, p.x2)[k] for p in placed], least) for k in range(len(regions.axes))]
    tried = sum(cut.tried for cut in cuts if cut is not None)
    if not tried:
        return None
    from scipy.special import chdtri  # takes longer to load than all of a short command

    k, cut = min(((k, cut) for k, cut in enumerate(cuts) if cut is not None), key=lambda one: one[1].left)
    in_time = _best_cut(weighted, [p.t_s for p in placed], least)
    one = _side(weighted).left
    limit = -2 * math.log(settings.alpha / tried)
    against_time = (one if in_time is None else in_time.left) - cut.left
    explains = one - cut.left > limit and against_time >= settings.against_time
    consistent = cut.left <= chdtri(SIZE * (len(placed) - 2), settings.alpha)
    apart = cut.above.mean - cut.below.mean
    low, high = regions.span(region, k)
    room = min(cut.boundary - low, high - cut.boundary)  # the boundary leaves room for the hysteresis on both sides
    differs = float(np.max(np.abs(apart))) >= math.log(settings.split_factor)
    if not (explains and consistent and differs and room > 0 and room >= 2 * regions.axes[k].hysteresis):
        return None
    places, counted = (regions.names[region],), (cut.below.count, cut.above.count)
    numbers = (one - cut.left, limit, against_time)
    return _advice(AdviceKind.SPLIT, places, regions.axes[k], cut.boundary, apart, counted, *numbers)


def _advice(
    kind: AdviceKind,
    places: tuple[str, ...],
    axis: Axis,
    boundary: float,
    apart: FloatArray,
    counted: tuple[int, int],
    *numbers: float,
) -> RegionAdvice:
    """The advice on one boundary. apart : difference of the means in logarithms. numbers : what was weighed."""
    kc_factor, tau_i_factor = math.exp(float(apart[0])), math.exp(float(apart[1]))
    return RegionAdvice(kind, places, axis.label, axis.unit, boundary, kc_factor, tau_i_factor, counted, *numbers)


def _merges(
    regions: Regions, region_models: Mapping[int, RegionModel], sample_time_s: float, settings: AdviceSettings
) -> Iterator[RegionAdvice]:
    known = {
        i: _side(_weighted(region_model.points, sample_time_s, settings.scatter))
        for i, region_model in region_models.items()
        if len(region_model.points) >= settings.least_records
    }
    for k, axis in enumerate(regions.axes):
        for n, bound in enumerate(axis.bounds):
            pairs = [
                (i, j)
                for i in range(len(regions))
                for j in regions.neighbours(i)
                if i < j and regions.boundary(i, j).axis == k and regions.cell(i)[k] == n
            ]
            if not all(i in known and j in known for i, j in pairs):
                continue
            told = [_apart(known[i], known[j], settings) for i, j in pairs]
            most = max(factor for factor, _ in told)
            if most > settings.merge_factor:
                continue
            apart = max((difference for _, difference in told), key=lambda d: float(np.max(np.abs(d))))
            names = tuple(regions.names[i] for pair in pairs for i in pair)
            below, above = (sum(known[pair[side]].count for pair in pairs) for side in (0, 1))
            numbers = (most, settings.merge_factor)
            yield _advice(AdviceKind.MERGE, names, axis, bound, apart, (below, above), *numbers)


def _apart(one: _Side, other: _Side, settings: AdviceSettings) -> tuple[float, FloatArray]:
    """The largest factor between two settings with its uncertainty, and the difference in logarithms."""
    apart = other.mean - one.mean
    unsure = settings.bound_std * np.sqrt(np.diag(one.p + other.p))
    return math.exp(float(np.max(np.abs(apart) + unsure))), apart
