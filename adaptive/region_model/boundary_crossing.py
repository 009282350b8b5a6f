"""A response that crossed a boundary teaches both sides, and whatever lay on its way.

A linear model of a long step over a process that changes is a fiction: where the gain falls along the way, pv begins
fast and ends early, and a shorter lag explains it. So the record is fitted in motion, as the schedule's design fits a
whole day (schedule_design/joint.py, motion.py): every parameter is a curve over the scheduling variable, with a prior
about the linear model of the same record. At the centre of each region the curves say what the process is there, with a
covariance: small where the response spent time and travel, larger beyond. That is one measurement of the region, and
passes the same filter and gate as any record. It agrees or is left aside, and never overrules records of the region
itself. What was learned so is proved on the whole spread of the covariance, as what is borrowed is.

Nor does a percent of co act alike everywhere (a valve's curve, burst firing), and on the way co is far from where it
rests. A fit without that gave Kc of a tank behind an equal-percentage valve as 0.6 to 3.4 of what is right. So the
slope of an installed characteristic is fitted beside, from all records so far (co_curve.py). At a place it counts as it
is for the co that rests there, by a straight line between both ends of the record.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from retuner.adaptive.identification.candidate import MODEL_ERROR
from retuner.adaptive.identification.estimate import (
    Alternative,
    LogModel,
    ModelEstimate,
    factors_text,
    proper_covariance,
    spread,
)
from retuner.adaptive.identification.identify import Fits, FitSettings
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.co_curve import CoCurve, added, before
from retuner.adaptive.region_model.kalman import back_to_mean, gate, update, widened
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel, remembered
from retuner.adaptive.region_model.update import Agreement, Learned, TrackerSettings, grown, scattered
from retuner.adaptive.schedule_design.curves import inflation
from retuner.adaptive.schedule_design.joint import CurveForm, Joint, Noise, noise_of, refined
from retuner.adaptive.schedule_design.record_stretches import (
    SLOPE_STD,
    CurveAxis,
    CurveShape,
    Stretch,
    over,
    signals_of,
)
from retuner.adaptive.schedule_design.rest_curve import RestCurve
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, LoopSample, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.regions import Regions

# ---- One record of a process that changes along its way: fitted in motion, with curves for its parameters

MOST_ROWS = 300  # rows of the record in the fit; longer ones are condensed
ITERATIONS = 15
BESIDE = 2.0  # Dead times from a setpoint step within which no load step is believed
SECOND_LAG = 0.35  # share of theta with which a second lag starts


@dataclass(frozen=True, slots=True)
class InMotion:
    """One structure's curves as one record shows them.

    evidence : n ln sigma^2 and what load steps cost. left : standard deviation of what is not explained, pv units.
    rest : the co that holds a place.
    """

    type: ProcessType
    form: CurveForm
    rest: RestCurve
    z: FloatArray
    covariance: FloatArray
    evidence: float
    left: float

    def at(self, place: float) -> LogModel:
        """The process at a place, with its covariance."""
        rows = np.zeros((len(self.form.shapes), self.form.size))
        for i, (where, shape) in enumerate(zip(self.form.places, self.form.shapes, strict=True)):
            rows[i, where] = self.form.axis.columns(np.array(place), shape)
        if self.form.felt is not None:
            rows[0, self.form.felt_place] = self.form.felt.columns(self.rest.co(np.array([place])))[0]
        ln = np.array(self.form.centre) + rows @ self.z
        if self.form.felt is not None:
            ln[0] += self.form.felt.known(self.rest.co(np.array([place])))[0]
        slopes = np.stack(
            [(_log_of(ln + step) - _log_of(ln - step)) / (2 * STEP) for step in STEP * np.eye(len(ln))], 1
        )
        p = slopes @ rows @ self.covariance @ rows.T @ slopes.T
        return LogModel(_log_of(ln), proper_covariance(p), self.form.sign, self.type)

    @property
    def co_curve(self) -> CoCurve | None:
        """What this record adds to what was known of co's curve; None where that is nothing."""
        felt, i = self.form.felt, self.form.felt_place.start
        if felt is None:
            return None
        unit = felt.doubt * 2 * SLOPE_STD / (felt.axis.high - felt.axis.low)
        now = CoCurve(felt.slope + unit * float(self.z[i]), unit * math.sqrt(float(self.covariance[i, i])))
        return added(CoCurve(felt.slope, unit), now)


STEP = 1e-4


def _log_of(ln: FloatArray) -> FloatArray:
    """The logarithms of fit/structure.py from ln b, ln theta, ln tau (, ln tau2)."""
    b, theta, *lags = np.exp(ln).tolist()
    if len(lags) == 1:
        return np.asarray(ln, dtype=np.float64)
    total = lags[0] + lags[1]
    return np.log([b * lags[0] / total, theta, total, lags[0] * lags[1] / total])


def in_motion(
    window: Window, x: FloatArray, axis: CurveAxis, alone: ModelEstimate, curves: Sequence[CoCurve] = ()
) -> tuple[InMotion, ...]:
    """The curves, one or two lags, the more likely first; none where the linear models have no lag.

    window : the record. x : where the process is at its samples, shape (n,). axis : of the table. alone : the linear
        models of the record, from which it starts. curves : what other records say of co's curve.
    """
    every = -(-len(window.t_s) // MOST_ROWS)
    signals = signals_of(window, x, every)
    stretch = Stretch(signals, 0, len(signals.t_s), changed=True)
    joint = Joint.of([stretch])
    lagged = next((a.log.model() for a in alone.alternatives if a.log.type in _STARTS), None)
    if lagged is None:
        return ()
    lag = lagged.tau1_s + lagged.tau2_s
    centre = (math.log(abs(lagged.k) / lag), math.log(lagged.theta_s), math.log(lag))
    felt = over(
        [stretch], CurveShape.LINE
    )  # how co acts, as it is known before this record; None where co stands still
    if felt is not None:
        travel = felt.axis.high - felt.axis.low
        known = before(curves, travel)
        felt = replace(felt, slope=known.slope, doubt=known.std * travel / (2 * SLOPE_STD))
    form = CurveForm(axis, (CurveShape.BENT,) * 3, centre, 1 if lagged.k > 0 else -1, felt)
    # where load steps enter by the linear models, but for those beside the setpoint's step: curves explain them
    near_s, changes = BESIDE * alone.log.model().theta_s, [stretch.signals.t_s[row] for row in stretch.signals.changes]
    entered = [t for t in alone.load_times_s if all(abs(t - at_s) > near_s for at_s in changes)]
    rows = np.searchsorted(stretch.t_s, entered) - 1
    linear = tuple(sorted({int(row) for row in rows if 0 < row < len(stretch) - 2}))
    # a lag beside the first, out of the dead time
    halved = (centre[0], centre[1] + math.log1p(-SECOND_LAG), centre[2], centre[1] + math.log(SECOND_LAG))
    second = replace(form, shapes=(*form.shapes, CurveShape.CONSTANT), centre=halved)
    found = []
    for loads in sorted({joint.loads[0], linear}, key=len):
        one = _fitted(replace(joint, loads=(loads,)), form)
        start = np.insert(one.z, form.felt_place.start, 0.0)
        found += [one, _fitted(replace(joint, loads=(loads,)), second, start)]
    best = [min((f for f in found if f.type is t), key=lambda f: f.evidence) for t in _STARTS]
    return tuple(sorted(best, key=lambda one: one.evidence + len(one.form.shapes) * math.log(len(stretch))))


_STARTS = (ProcessType.FOPDT, ProcessType.SOPDT)


def _fitted(joint: Joint, form: CurveForm, start: FloatArray | None = None) -> InMotion:
    """One structure: first as if what is left were white, or slow noise would stand for what the curves can say."""
    pv = joint.stretches[0].pv
    floor = math.hypot(noise_sigma(pv), MODEL_ERROR * float(np.ptp(pv)))
    noise = Noise((), np.array([floor]))
    now = refined(joint, form, np.zeros(form.size) if start is None else start, noise, ITERATIONS)
    found = noise_of(now.left, 1e-6 * floor)
    now = refined(joint, form, now.z, replace(found, sigma=np.hypot(found.sigma, floor)), ITERATIONS)
    c = max(inflation(now), 1.0)
    assert now.jacobian is not None
    information = np.eye(form.size) + now.jacobian.T @ now.jacobian / c
    covariance = proper_covariance(np.asarray(np.linalg.inv(information), dtype=np.float64))
    evidence = len(now.r) * math.log(float(np.mean(now.left[0] ** 2))) + 2 * len(joint.loads[0]) * math.log(len(now.r))
    type_ = ProcessType.SOPDT if len(form.shapes) > 3 else ProcessType.FOPDT
    rest = RestCurve.on_the_way(joint.stretches[0])
    return InMotion(type_, form, rest, now.z, covariance, evidence, float(np.std(now.left[0])))


ELSEWHERE = 0.1
"""How far curves through one record may stand from a region's process beside what they know, one standard deviation of
every logarithm: they have few bends, and the process may depend on more than the scheduling variable."""


def ways_of(regions: Regions, samples: Sequence[LoopSample]) -> tuple[FloatArray, ...]:
    """Where the process was on each axis, shapes (n,). Along the setpoint that is pv, which follows."""
    names = ("pv" if axis.variable == "sp" else name for axis, name in zip(regions.axes, ("x", "x2"), strict=False))
    return tuple(np.array([getattr(sample, name) for sample in samples]) for name in names)


@dataclass(frozen=True, slots=True)
class Crossing:
    """A record that crossed boundaries, and what was known before it.

    ways : where the process was on each axis at the window's samples. start_s : begin of the response in it.
    in_force : gains at its end. regions : the table's. region_models : what is known of each. tracker, fit : settings.
    """

    window: Window
    ways: tuple[FloatArray, ...]
    start_s: float
    in_force: PidGains
    regions: Regions
    region_models: Mapping[int, RegionModel]
    tracker: TrackerSettings
    fit: FitSettings

    @property
    def t_s(self) -> float:
        """Time of the record's last sample."""
        return float(self.window.t_s[-1])

    @property
    def reached(self) -> list[tuple[float, float]]:
        """Least and largest value of the response on each axis."""
        during = self.window.t_s >= self.start_s
        return [(float(np.min(way[during])), float(np.max(way[during]))) for way in self.ways]

    @property
    def along(self) -> int:
        """The axis on which it went farthest, in shares of the range."""
        shares = [
            (high - low) / (axis.high - axis.low)
            for axis, (low, high) in zip(self.regions.axes, self.reached, strict=True)
        ]
        return int(np.argmax(shares))

    def passed(self) -> list[int]:
        """Regions on its way."""
        spans = {r: [self.regions.span(r, axis) for axis in range(len(self.ways))] for r in range(len(self.regions))}
        return [
            region
            for region, own in spans.items()
            if all(low < last and first < high for (low, high), (first, last) in zip(own, self.reached, strict=True))
        ]


@dataclass(frozen=True, slots=True)
class FittedCrossing:
    """What the record shows: the linear models alone, and the curves, the more likely structure first."""

    alone: ModelEstimate
    found: tuple[InMotion, ...]


def fitted_crossing(crossing: Crossing) -> FittedCrossing:
    """The record fitted."""
    alone = Fits(crossing.window, (crossing.in_force.direction,), crossing.fit).estimate()
    if alone.explained < crossing.fit.explained_limit:
        return FittedCrossing(alone, ())
    axis = crossing.regions.axes[crossing.along]
    x = np.clip(crossing.ways[crossing.along], axis.low, axis.high)
    points = [point for model in crossing.region_models.values() for point in model.points]
    found = {point.t_s: point.co_curve for point in points if point.co_curve is not None}  # one teaches several regions
    curves = [found[t_s] for t_s in sorted(found)]
    return FittedCrossing(alone, in_motion(crossing.window, x, CurveAxis(axis.low, axis.high), alone, curves))


def update_across(crossing: Crossing, shown: FittedCrossing, region: int, known: RegionModel | None) -> Learned:
    """Take the record into what is known of one region.

    known : of the region, None for nothing; what is borrowed has no records.
    """
    own = known if known is not None and known.records else None
    if not shown.found:
        return Learned(own, shown.alone, Agreement.SILENT, 0.0)
    # What the record by itself says of a region, at its centre
    logs = [_at_centre(crossing, one, region) for one in shown.found]
    best, alone, limit = logs[0], shown.alone, crossing.fit
    unsure = best.gain_uncertainty(crossing.window.sample_time_s)
    left = shown.found[0].left  # what the curves leave; beyond : in standard deviations of the noise
    beyond = replace(alone, residual_std=left).unexplained(float(np.ptp(crossing.window.pv)))
    is_known = unsure <= limit.gain_std_limit and beyond <= limit.remainder_limit
    reason = "fitted along its way, with the process in motion"
    if beyond > limit.remainder_limit:
        reason = f"the model leaves {beyond:.1f} times the noise (limit {limit.remainder_limit:g})"
    elif not is_known:
        factor, needed = factors_text(2 * unsure, 2 * limit.gain_std_limit)
        reason = f"Response crossed a region boundary: by itself Kc uncertain by {factor}x (limit {needed}x)"
    # as measurements of the region: R x = z + unit noise
    roots = [np.linalg.cholesky(np.linalg.inv(log.p)).T for log in logs]
    measured = zip(logs, shown.found, roots, strict=True)
    samples = len(crossing.window.t_s)
    alternatives = [Alternative(log, one.evidence, root, root @ log.x, samples) for log, one, root in measured]
    estimate = replace(
        alone,
        identifiable=is_known,
        reason=reason,
        residual_std=left,
        alternatives=tuple(alternatives),
        plausible=spread(scattered(best, crossing.tracker)),
    )
    if beyond > limit.remainder_limit:
        return Learned(own, estimate, Agreement.SILENT, 0.0)
    curve = shown.found[0].co_curve
    if known is not None and known.log.sign == estimate.log.sign:
        innovation, after = _filtered(crossing, known, estimate)
        if after and innovation <= gate(len(known.log.x), crossing.tracker.gate):
            now = _known(crossing, region, after, estimate, innovation, before=own, curve=curve)
            return Learned(now, estimate, Agreement.AGREES, innovation)
        if own is not None:
            return Learned(own, estimate, Agreement.CONTRADICTS, innovation)
    after = [StructureModel(scattered(a.log, crossing.tracker), a.evidence) for a in estimate.alternatives]
    first = _known(crossing, region, after, estimate, 0.0, before=None, curve=curve)
    return Learned(first, estimate, Agreement.FIRST, 0.0)


def taught_beside(crossing: Crossing, shown: FittedCrossing, taught: int) -> dict[int, RegionModel]:
    """What the other regions on the way learn. taught : the region in which the response ended."""
    found = {}
    for region in crossing.passed():
        if region != taught:
            learned = update_across(crossing, shown, region, crossing.region_models.get(region))
            if learned.region_model is not None and learned.agreement in {Agreement.FIRST, Agreement.AGREES}:
                found[region] = learned.region_model
    return found


def _at_centre(crossing: Crossing, one: InMotion, region: int) -> LogModel:
    """The process of one structure at a region's centre; on another axis it may be anything that the curves allow."""
    log = one.at(crossing.regions.centre(region, crossing.along))
    more = ELSEWHERE**2
    for k, (axis, reached) in enumerate(zip(crossing.regions.axes, crossing.reached, strict=True)):
        if k != crossing.along:
            places = np.array([sum(reached) / 2, crossing.regions.centre(region, k)])
            here, there = CurveAxis(axis.low, axis.high).columns(places, CurveShape.BENT)
            more += float(np.sum((there - here) ** 2))
    return widened(log, more)


def _filtered(
    crossing: Crossing, known: RegionModel, estimate: ModelEstimate
) -> tuple[float, Sequence[StructureModel]]:
    """Innovation under the leading structure that both have, and what is known after; nothing where they have none."""
    settings, after, innovation = crossing.tracker, [], None
    has = {a.log.type for a in estimate.alternatives}
    for k in known.known:
        mean = grown(k, crossing.t_s - known.t_s, settings) if known.records else k
        if k.log.type in has:
            there = scattered(mean.log, settings)
            statistic, posterior = update(there, estimate)
            innovation = statistic if innovation is None else innovation
            mean = replace(mean, log=back_to_mean(mean.log, there, posterior))
        after.append(mean)
    # A structure that such a record cannot show leads on only where it is known well enough for settings
    dt_s, limit = crossing.window.sample_time_s, crossing.fit.gain_std_limit
    after.sort(key=lambda k: k.log.type not in has and k.log.gain_uncertainty(dt_s) > limit)
    return (0.0, ()) if innovation is None else (innovation, after)


def _known(
    crossing: Crossing,
    region: int,
    known: Sequence[StructureModel],
    estimate: ModelEstimate,
    innovation: float,
    *,
    before: RegionModel | None,
    curve: CoCurve | None,
) -> RegionModel:
    """What is known of a region now. before : what was, from records of its own. curve : of co, by this record."""
    log = known[0].log
    unsure, limit = log.gain_uncertainty(crossing.window.sample_time_s), crossing.fit.gain_std_limit
    place = [crossing.regions.centre(region, axis) for axis in range(len(crossing.ways))]
    point = RecordPoint(crossing.t_s, place[0], place[1] if len(place) > 1 else 0.0, estimate.log, innovation, curve)
    return RegionModel(
        tuple(known),
        (before.records if before else 0) + 1,
        crossing.t_s,
        before.alternative if before else None,
        remembered(before.points if before else (), point),
        spread(scattered(log, crossing.tracker)),
        identifiable=unsure <= limit,
        reason=estimate.reason,
    )
