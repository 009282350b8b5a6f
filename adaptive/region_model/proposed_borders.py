"""Another schedule, where a region is too wide for one set: a boundary inside it, or sets that are interpolated.

The curves through what is known of the regions (region_curves.py) say what the process is at places from end to end of
every region, and how well that is known. The chances that a set is in spec at them add up to how many of them it is
expected to serve. Whether the sets in force are the best ones is not asked here: that is seen to from response to
response. A region with the set that serves it best is weighed against the same region with a boundary in it and the
best set on either side, and against means of the sets at the centres. What is not known well lowers all of them alike,
so doubt proposes nothing. Nothing is changed by it: a person takes it up, or leaves it.

Pure: a table and region models in, a proposal out.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from retuner.adaptive.identification.estimate import LogModel, proper_covariance
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.region_model.region_curves import RegionCurves, curves, lenders
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.split_or_merge import features
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.schedule_design.places import LEAST_STD, DesignLimits, iae
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.regions import Regions, choose, enter
from retuner.schedule.table import GainTable, Lookup

# A place along the scheduling variable, and how likely a set of gains is in spec there.
#
# At a place a set is in spec while Ms and J keep their limits. Along a shape (one tau_I) that is an interval of ln Kc,
# worked out on the likeliest process. What is not known of a process is above all its ln Kc, so with its doubt s
#
#     P(in spec) = Phi((high - ln Kc)/s) - Phi((low - ln Kc)/s)

MS_END = 2.1  # largest Ms where a set ends, the guard's own limit at a boundary (guard/guard_settings.py)
OVER_OWN = 1.03
"""Times the Ms of a place's own settings that a set may have there, where these are over the limit themselves."""
KC_TRIED = 25  # gains that are tried of each shape
WIDEST = math.log(8.0)  # widest interval in which a gain keeps its limits, either way from the place's own
BISECTIONS = 12
J_BISECTIONS = 6


@dataclass(frozen=True)
class Spot:
    """A place x: the likeliest process there, and how well Kc is known.

    process : as the sampled controller sees it. ln_std : of ln Kc. own : SIMC's set. iae : of it, for a step of the
    setpoint and of the load.
    """

    x: float
    model: ProcessModel
    process: LinearProcess
    ln_std: float
    own: PidGains
    iae: tuple[float, float]
    sample_time_s: float
    limits: DesignLimits
    _asked: dict[float, tuple[float, float, float]] = field(default_factory=dict, repr=False, compare=False)

    def ms(self, gains: PidGains) -> float:
        """Ms by the likeliest process."""
        return sensitivity_peak(self.process, gains)

    def interval(self, tau_i_s: float) -> tuple[float, float, float]:
        """ln |Kc| of this shape from which J is kept, up to which Ms is, and up to which Ms is that of an end."""
        if tau_i_s not in self._asked:
            limit = max(self.limits.ms, OVER_OWN * self.ms(self.own))
            high, end = (self._largest(tau_i_s, ms) for ms in (limit, max(MS_END, limit)))
            self._asked[tau_i_s] = (self._least(tau_i_s, high), high, end)
        return self._asked[tau_i_s]

    def chance(self, ln_kc: float, tau_i_s: float) -> float:
        """The chance that a set is in spec here."""
        low, high, _ = self.interval(tau_i_s)
        return max(_normal((high - ln_kc) / self.ln_std) - _normal((low - ln_kc) / self.ln_std), 0.0)

    def _set(self, ln_kc: float, tau_i_s: float) -> PidGains:
        kc = math.copysign(math.exp(ln_kc), self.own.kp)
        return PidGains(kc, kc / tau_i_s, 0.0)

    def _largest(self, tau_i_s: float, ms: float) -> float:
        middle = math.log(abs(self.own.kp))
        return _gain_at_limit(
            lambda x: self.ms(self._set(x, tau_i_s)) <= ms, middle - WIDEST, middle + WIDEST, BISECTIONS
        )

    def _least(self, tau_i_s: float, high: float) -> float:
        """inf where J is not kept even at the largest gain."""
        if not self._is_fast(high, tau_i_s):
            return math.inf
        return -_gain_at_limit(lambda x: self._is_fast(-x, tau_i_s), -high, WIDEST - high, J_BISECTIONS)

    def _is_fast(self, ln_kc: float, tau_i_s: float) -> bool:
        gains = self._set(ln_kc, tau_i_s)
        if not math.isfinite(self.ms(gains)):
            return False
        found = iae(self.model, gains, self.sample_time_s)
        return sum(one / own for one, own in zip(found, self.iae, strict=True)) / 2 <= self.limits.j


def _gain_at_limit(keeps: Callable[[float], bool], low: float, high: float, times: int) -> float:
    """The largest value up to which something is kept that is so at low."""
    for _ in range(times):
        middle = (low + high) / 2
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return low


def _normal(z: float) -> float:
    return 0.5 * math.erfc(-z / math.sqrt(2)) if math.isfinite(z) else float(z > 0)


@dataclass(frozen=True, slots=True)
class Best:
    """The set that serves some places best: how many of them are expected to be in spec."""

    gains: PidGains
    kept: float


def spot_of(x: float, log: LogModel, sample_time_s: float, limits: DesignLimits) -> Spot | None:
    """The place x by what is known of the process there; None where that is not known well enough."""
    ln_std = math.hypot(math.sqrt(float(features(log, sample_time_s).p[0, 0])), LEAST_STD)
    model = log.model()
    plain = without_second_lag(model.seen_by_controller(sample_time_s))
    own = simc(plain, plain.theta_s).gains
    process = model.seen_by_controller(sample_time_s).linear()
    if ln_std > limits.std or not math.isfinite(sensitivity_peak(process, own)):
        return None
    return Spot(x, model, process, ln_std, own, iae(model, own, sample_time_s), sample_time_s, limits)


def best_of(spots: Sequence[Spot]) -> Best:
    """The set for these places, in order: the shape of one of three, within what a boundary bears at both ends."""
    shapes = {spot.own.kp / spot.own.ki: None for spot in (spots[0], spots[len(spots) // 2], spots[-1])}
    return max((_of_shape(spots, tau_i_s) for tau_i_s in shapes), key=lambda one: one.kept)


def _of_shape(spots: Sequence[Spot], tau_i_s: float) -> Best:
    """The best gain of a shape, by one standard deviation inside what a boundary bears at either end."""
    own = [math.log(abs(spot.own.kp)) for spot in spots]
    most = min(spot.interval(tau_i_s)[2] - spot.ln_std for spot in (spots[0], spots[-1]))
    tried = np.minimum(np.linspace(min(own) - 0.3, max(own) + 0.3, KC_TRIED), most).tolist()
    kept = [sum(spot.chance(ln_kc, tau_i_s) for spot in spots) for ln_kc in tried]
    at = int(np.argmax(kept))
    kc = math.copysign(math.exp(tried[at]), spots[0].own.kp)
    return Best(PidGains(kc, kc / tau_i_s, 0.0), kept[at])


PLACES = 5  # places of a region, from end to end; those between the ends are where a boundary is tried
LEAST_RECORDS = 3  # records that every region must have
LEAST_KNOWN = 3  # places of a region that must be known; the others demand nothing
TOO_WIDE = 0.6  # share of a region's places that its best set must serve, or the region is too wide
WORTH = 0.15  # share of a region's places by which another schedule must serve more of them, in expectation
CALMER = (1.0, 0.92, 0.85)  # factors on the sets of an interpolation: a mean of two sets may be too much between them


@dataclass(frozen=True, slots=True)
class TooWide:
    """A region that no one set serves.

    region : its name. kc_factor : the larger over the smaller of the Kc that
    its places ask for. share, share_then : of its places that the best set serves, and that the other schedule does.
    """

    region: str
    kc_factor: float
    share: float
    share_then: float

    @property
    def sentence(self) -> str:
        """What is known of it."""
        return (
            f"Region {self.region} is too wide for one set: the Kc asked for differs inside it by a factor of "
            f"{self.kc_factor:.2g}. At its best a set serves {self.share:.0%} of it, with the proposal "
            f"{self.share_then:.0%}."
        )


@dataclass(frozen=True, slots=True)
class Refinement:
    """A proposal with what it rests on.

    table : as proposed. places : that are known. kept, kept_then : of these, where the limits are expected to be kept
    by the table as it is with the best set in each region, and by the other. ms, ms_then : largest Ms at any of them by
    the likeliest models. limits : of Ms and J. wide : the regions for the sake of which it is proposed.
    """

    table: GainTable
    places: int
    kept: float
    kept_then: float
    ms: float
    ms_then: float
    limits: DesignLimits
    wide: tuple[TooWide, ...] = ()

    @property
    def sentence(self) -> str:
        """The proposal in a few sentences."""
        axis = self.table.regions.axes[0]
        hard = self.table.lookup is Lookup.HARD
        bounds = ", ".join(f"{bound:.4g}" for bound in self.table.regions.bounds)
        knots = ", ".join(f"{self.table.regions.centre(i):.4g}" for i in range(len(self.table.gains)))
        what = f"steps at {axis.label} = {bounds}" if hard else f"interpolation about {axis.label} = {knots}"
        return " ".join(
            [
                *(one.sentence for one in self.wide),
                f"Another schedule serves more places: {what} {axis.unit}".rstrip() + ".",
                f"Ms {self.limits.ms:g} and {self.limits.j:g} times SIMC's IAE are then expected to hold at "
                f"{self.kept_then:.1f} of {self.places} places. "
                f"With the best set in each region as it is they hold at {self.kept:.1f}. "
                f"The largest Ms is then {_ms(self.ms_then)} instead of {_ms(self.ms)}.",
            ]
        )

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "kind": "refine",
            "sentence": self.sentence,
            "lookup": str(self.table.lookup),
            "bounds": list(self.table.regions.bounds),
            "knots": [self.table.regions.centre(i) for i in range(len(self.table.gains))],
            "gains": [{"kp": one.kp, "ki": one.ki, "kd": one.kd} for one in self.table.gains],
            "places": self.places,
            "kept": [self.kept, self.kept_then],
            "ms": [one if math.isfinite(one) else None for one in (self.ms, self.ms_then)],
            "too_wide": [
                {"region": w.region, "kc_factor": w.kc_factor, "share": [w.share, w.share_then]} for w in self.wide
            ],
        }


def _ms(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "that of an unstable loop"


def proposed_borders(
    table: GainTable,
    region_models: Mapping[int, RegionModel],
    t_s: float,
    sample_time_s: float,
    tracker: TrackerSettings,
    limits: DesignLimits | None = None,
) -> Refinement | None:
    """The proposal; None where every region is served, or too little is known.

    table : in force, steps along one variable. region_models : what is known, by region. t_s : now. sample_time_s : of
        the controller. limits : of Ms and J, those of a schedule's design where nothing is said.
    """
    wanted = limits or DesignLimits()
    spots = _known_spots(table, region_models, t_s, sample_time_s, tracker, wanted)
    now = {region: best_of(row) for region, row in spots.items()}
    wide = [region for region, row in spots.items() if now[region].kept < TOO_WIDE * len(row)]
    if not wide:
        return None
    ways = [_interpolated(table, spots, factor) for factor in CALMER] if len(spots) == len(table.regions) else []
    most = max(MS_END, _largest_ms(table, spots))
    ways = [way for way in (*_split(table, spots, now, wide), *ways) if _largest_ms(way.table, spots) <= most]
    if not ways:
        return None
    best = max(ways, key=lambda way: sum(way.kept.values()))
    told = tuple(
        _told(table, region, spots[region], now[region].kept, best.kept[region])
        for region in wide
        if best.kept[region] - now[region].kept >= WORTH * len(spots[region])
    )
    places, kept, then = sum(map(len, spots.values())), sum(one.kept for one in now.values()), sum(best.kept.values())
    if not told or then - kept < WORTH * PLACES:
        return None
    ms = max(spot.ms(now[region].gains) for region, row in spots.items() for spot in row)
    return Refinement(best.table, places, kept, then, ms, _largest_ms(best.table, spots), wanted, told)


def _known_spots(
    table: GainTable,
    region_models: Mapping[int, RegionModel],
    t_s: float,
    sample_time_s: float,
    tracker: TrackerSettings,
    limits: DesignLimits,
) -> dict[int, list[Spot]]:
    """Known places from end to end of every region that has records of its own, its middle among them."""
    sign, regions = table.gains[0].direction, table.regions
    own = {i: model for i, model in lenders(region_models, sign).items() if model.records >= LEAST_RECORDS}
    through = curves(own, regions, t_s, tracker)
    if not through or len(regions.axes) > 1 or table.lookup is not Lookup.HARD:
        return {}
    behind = {t: sum(k.evidence for model in own.values() for k in model.known if k.log.type is t) for t in through}
    type_ = min(behind, key=lambda t: behind[t])
    found = {}
    for region in own:
        xs = np.linspace(*regions.span(region), PLACES).tolist()
        row = [spot_of(x, _log(through[type_], x, sign, type_), sample_time_s, limits) for x in xs]
        known = [spot for spot in row if spot is not None]
        found.update({region: known} if len(known) >= LEAST_KNOWN and row[PLACES // 2] is not None else {})
    return found


def _largest_ms(table: GainTable, spots: Mapping[int, Sequence[Spot]]) -> float:
    """The largest Ms at any known place, by the likeliest process."""
    return max(spot.ms(in_force(table, spot.x)) for row in spots.values() for spot in row)


def in_force(table: GainTable, x: float) -> PidGains:
    """The gains at a place that the loop has come to slowly from below."""
    law = table.regions.law()
    return table.at(choose(law, enter(law, x, 0.0), x, 0.0).region, x)


def _log(curve: RegionCurves, x: float, sign: int, type_: ProcessType) -> LogModel:
    mean, p = curve.at((x,))
    return LogModel(mean, proper_covariance(p), sign, type_)


@dataclass(frozen=True, slots=True)
class _Cut:
    """A boundary inside a region, and the sets below and above; a place on it counts on both sides by half."""

    x: float
    below: Best
    above: Best


def _best_border(row: Sequence[Spot]) -> _Cut:
    """The boundary that serves most places of a region."""
    cuts = []
    for at in range(1, len(row) - 1):
        parts = (best_of(row[: at + 1]), best_of(row[at:]))
        below, above = (Best(part.gains, part.kept - _chance(row[at], part.gains) / 2) for part in parts)
        cuts.append(_Cut(row[at].x, below, above))
    return max(cuts, key=lambda cut: cut.below.kept + cut.above.kept)


def _chance(spot: Spot, gains: PidGains) -> float:
    return spot.chance(math.log(abs(gains.kp)), gains.kp / gains.ki)


@dataclass(frozen=True, slots=True)
class _Way:
    """A schedule, and how many places of each present region it is expected to serve."""

    table: GainTable
    kept: dict[int, float]


def _split(
    table: GainTable, spots: Mapping[int, Sequence[Spot]], now: Mapping[int, Best], wide: Sequence[int]
) -> list[_Way]:
    """The table with a boundary in the regions that are too wide, their sets the best on either side; the others keep
    theirs. Nothing where no boundary is worth it.
    """
    names: list[str] = []
    bounds: list[float] = []
    sets: list[PidGains] = []
    kept = {region: best.kept for region, best in now.items()}
    for region, name in enumerate(table.regions.names):
        bounds.append(table.regions.span(region)[0])
        cut = _best_border(spots[region]) if region in wide else None
        more = cut.below.kept + cut.above.kept - now[region].kept if cut is not None else 0.0
        low, high = table.regions.span(region)  # the boundary leaves the hysteresis its room on both sides
        room = cut is not None and min(cut.x - low, high - cut.x) >= 2 * table.regions.axes[0].hysteresis
        if cut is None or more < WORTH * len(spots[region]) or not room:
            names, sets = [*names, name], [*sets, table.gains_of(region)]
            continue
        names += [f"{name} lower", f"{name} upper"]
        bounds, sets = [*bounds, cut.x], [*sets, cut.below.gains, cut.above.gains]
        kept[region] += more
    if len(sets) == len(table.gains):
        return []
    return [_Way(_table_of(table, tuple(names), tuple(bounds[1:]), tuple(sets), Lookup.HARD), kept)]


def _interpolated(table: GainTable, spots: Mapping[int, Sequence[Spot]], factor: float) -> _Way:
    """The table with its regions' centres as knots, and the sets of these, a little calmer or not."""
    own = [min(spots[i], key=lambda s: abs(s.x - table.regions.centre(i))).own for i in range(len(table.regions))]
    sets = tuple(PidGains(*(factor * gain for gain in (one.kp, one.ki, one.kd))) for one in own)
    other = _table_of(table, table.regions.names, table.regions.bounds, sets, Lookup.INTERPOLATED)
    return _Way(other, {i: sum(_chance(spot, other.at(i, spot.x)) for spot in row) for i, row in spots.items()})


def _table_of(
    table: GainTable, names: tuple[str, ...], bounds: tuple[float, ...], sets: tuple[PidGains, ...], lookup: Lookup
) -> GainTable:
    """The next revision of a table, with other regions."""
    axis = table.regions.axes[0]
    regions = Regions(
        axis.variable,
        axis.unit,
        names,
        axis.low,
        bounds,
        axis.high,
        axis.hysteresis,
        axis.min_stay_s,
        axis.filter_s,
        axis.signal,
    )
    return GainTable(table.loop, regions, sets, lookup, table.revision + 1)


def _told(table: GainTable, region: int, row: Sequence[Spot], served: float, kept: float) -> TooWide:
    """What speaks for another schedule in one region."""
    asked = [abs(spot.own.kp) for spot in row]
    return TooWide(table.regions.names[region], max(asked) / min(asked), served / len(row), kept / len(row))
