"""What is known of one region's process, from response to response.

The state before a record is the prior inside the nonlinear fit that gives the record's linearisation, so the filter's
update (kalman.py) is the last step of an iterated extended Kalman filter (Bell & Cathey 1993) and its posterior
is the fit's own. Feeding the filter separately fitted points instead was tried and failed: a record of a load alone has
a bent ridge of likely parameters, and its Gaussian dragged the gain to a tenth.

    known + record -> the record by itself; the record with the known in its fit; do the two belong together?

A record that does not settle the process by itself still narrows it, so settings are asked of what is known after the
record. A record teaches nothing if it shows nothing of the process, or if a model without load steps at its setpoint
changes explains it in another way (fit/record.py).

All of this is kept per structure (fit/structure.py), each with the sum of what its records said for it, n ln sigma^2
plus the cost of loads and colour: information criteria add up, so the structure that leads may change at any time.

A record that contradicts what is known is kept as an alternative. The next record decides: if it agrees with the
alternative clearly better, the process has changed (or the first record was wrong), and the alternative takes over; if
it clearly agrees with the model, the alternative is forgotten; if it shows too little to tell, both take it in. The
contradicting record is believed at once if the loop is in danger by what it says, and the known becomes the
alternative. It is believed at once as well if it settles the process by itself and no settings could follow from what
was known.
"""

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.fit.record import setpoint_changes
from retuner.adaptive.fit.refine import Prior
from retuner.adaptive.identification.candidate import MODEL_ERROR, Candidate, load_price, with_priors
from retuner.adaptive.identification.dead_time_bound import bounded
from retuner.adaptive.identification.estimate import LogModel, ModelEstimate
from retuner.adaptive.identification.identify import Fits, FitSettings, estimate_of, inflation_of
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.kalman import back_to_mean, gate, surprise_of, update, widened
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel, remembered
from retuner.adaptive.region_model.steady_drift import TOLD, moved, told
from retuner.adaptive.schedule_design.record_stretches import SLOPE_STD
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.adaptive.valve.record_through_valve import ValveInLoop, valve_believed
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

# The first records of a region fitted as one: one process, each record with its own rest, loads and gains.
#
# What one record says by itself is a Gaussian round one optimum, and the first records are those of which that is least
# true: a load leaves a bent ridge, three peaks do not tell a lag from an integrator, a swing that grows hides the gain
# at rest. Taken in one after another they then contradict each other, or agree on a fiction. The samples themselves do
# not: a process that explains them all at once is found by a single fit, whatever gains ran.
#
#     pv_i / u_i, co_i / u_i      u_i the noise of record i, or how inexact any model is where that is more
#
# A linear process is the same in any unit, so each record is counted in its own; else one burst of an unstable loop
# would outweigh all that was seen at rest. Between two records stands a gap in time, after which the fit has a state
# and a load of its own (fit/misfit.py).

MOST_RECORDS = 3  # records that are fitted as one; what is known goes on from there as a mean that follows the process
MOST_SAMPLES = 750  # A record is kept in no more samples
GAP_SAMPLES = 6  # sampling intervals that stand between two records: a gap to the fit
END_SAMPLES = 5  # where a record ends and the next one begins is the median of so many
LEAST_SAMPLES = 30
"""A record of which fewer are left at the interval of the slowest says too little to be fitted with it."""


def kept(window: Window) -> Window:
    """A record as it is kept: every second, fourth ... sample of a long one, so that records still go together."""
    while len(window.t_s) > MOST_SAMPLES:
        window = window.condensed(-(-len(window.t_s) // 2))
    return window


def unit_of(window: Window) -> float:
    """What the residuals of a record are counted in, pv units; 1 where pv never moved."""
    return max(noise_sigma(window.pv), window.noise_std, MODEL_ERROR * float(np.ptp(window.pv))) or 1.0


def may_be_joined(windows: Sequence[Window]) -> bool:
    """Whether enough of every record is left at the sampling interval of the one that was kept at the longest."""
    dt_s = max(window.sample_time_s for window in windows)
    return all(len(window.t_s) >= LEAST_SAMPLES * _every(window, dt_s) for window in windows)


def joined(windows: Sequence[Window]) -> Window:
    """Records as one, the oldest first, each in its own unit and from where the one before ended.

    What a later record repeats of an earlier one's time is left out, unless that would leave nothing of it.
    """
    dt_s = max(window.sample_time_s for window in windows)
    parts: list[Window] = []
    end_s = -np.inf
    for window in windows:
        own = window.condensed(-(-len(window.t_s) // _every(window, dt_s)))
        later = own.t_s > end_s
        own = own.part(slice(int(np.argmax(later)), None)) if np.sum(later) >= END_SAMPLES else own
        unit = unit_of(own)
        t_s, sp, pv, co = own.t_s - own.t_s[0], own.sp / unit, own.pv / unit, own.co / unit
        if parts:
            before = parts[-1]
            pv, co = _going_on(pv, before.pv), _going_on(co, before.co)
            t_s = float(before.t_s[-1]) + GAP_SAMPLES * dt_s + t_s
            parts.append(Window(t_s, sp - sp[0] + before.sp[-1], pv, co))
        else:
            parts.append(Window(t_s, sp - sp[0], pv - sp[0], co - co[0]))
        end_s = float(window.t_s[-1])
    t_s, sp, pv, co = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_s", "sp", "pv", "co"))
    return Window(t_s, sp, pv, co)


def _every(window: Window, dt_s: float) -> int:
    """Number of samples of which one is left at such an interval."""
    return max(round(dt_s / window.sample_time_s), 1)


def _going_on(values: FloatArray, before: FloatArray) -> FloatArray:
    step = median(before[-END_SAMPLES:]) - median(values[:END_SAMPLES])
    return np.asarray(values + step, dtype=np.float64)


class Agreement(StrEnum):
    """How a record stood to what was known."""

    FIRST = "first record of this region"
    AGREES = "agrees with the model"
    CONTRADICTS = "contradicts the model: kept as an alternative until another record decides"
    CHANGED = "a second record confirms the alternative: the process has changed"
    OPENED = "contradicts the model near instability: adopted at once, with the old model as the alternative"
    SILENT = "does not identify the process: not used to update the model"

    @property
    def code(self) -> str:
        """The agreement's name in a decision."""
        return "odd" if self is Agreement.CONTRADICTS else self.name.lower()


ANEW = frozenset({Agreement.FIRST, Agreement.OPENED, Agreement.CHANGED})
"""Agreements after which the model rests on nothing that was believed before."""

MOST_SCATTER = 1.5  # a factor of 4.5; records that go on beyond the end of an axis have no more


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Settings of what is known of a region. Raises ValueError: one is outside its range."""

    walk_per_day: float = setting(0.1, "How far the logarithms wander in a day, one standard deviation", "0..1")
    walk_per_record: float = setting(
        0.03,
        "How far they wander from record to record, whatever the time: a gain that doubles within thirty is followed",
        "0..0.1",
    )
    # operating point and structure are never quite the same; with 0.12 a gain that doubles at once passes the gate. A
    # record that went over a whole axis has 1.4 (on_the_way)
    scatter: float = setting(
        0.06, "How much they differ between records within a region, one standard deviation", f"0..{MOST_SCATTER}"
    )
    # what no structure explains of a real record passes 3.09 now and then; a gain that has doubled lies far beyond 4.5
    gate: float = setting(4.5, "Innovation above which a record contradicts, as a one-sided normal deviate", "2..6")
    decisive: float = setting(
        6.0,
        "Deviance by which a record that fits both must speak for the alternative, or against it (odds of 20)",
        "2..20",
    )
    # and it is the alternative from then on
    clearer: float = setting(
        1.5, "A record gives way to one that contradicts it and knows the gain so many times better", "1..100"
    )
    most_lead: float = setting(
        60.0, "Evidence by which a structure may lead at the most, so that another may take over", "0.. nats"
    )
    danger_ms: float = setting(
        2.3, "Ms of the active gains from which a record that contradicts is believed at once", "1..10"
    )

    def __post_init__(self) -> None:
        require_in_range(self, "tracker")


@dataclass(frozen=True, slots=True)
class Learned:
    """Outcome of one record: the region's model now, the estimate that the record gave, how it stood to the old one.

    valve : what the record was seen through, where co did not reach the process as it is. contested : a model without
    load steps at setpoint changes explains the record in another way, whatever was made of it.
    """

    region_model: RegionModel | None
    estimate: ModelEstimate
    agreement: Agreement
    innovation: float
    valve: ValveInLoop | None = None
    contested: bool = False


SECONDS_PER_DAY = 86400.0


@dataclass(frozen=True, slots=True)
class NewRecord:
    """A record to be learned: its own fits, what it says alone, and where and when it was taken."""

    window: Window
    found: list[Candidate]
    alone: ModelEstimate
    at: tuple[float, float]
    settings: TrackerSettings
    fit: FitSettings

    @property
    def t_s(self) -> float:
        """Time of the last sample."""
        return float(self.window.t_s[-1])

    def point(self, innovation: float, told: tuple[tuple[float, float], ...]) -> RecordPoint:
        """What is remembered of it by itself."""
        return RecordPoint(self.t_s, *self.at, self.alone.log, innovation, told=told)


@dataclass(frozen=True, slots=True)
class Posterior:
    """What is known with a record taken in.

    rise : how much worse the two explain each other than each by itself (deviance). innovation : the same, never more
    than what the linear filter says. told : see RecordPoint.
    """

    known: tuple[StructureModel, ...]
    estimate: ModelEstimate
    innovation: float
    rise: float
    told: tuple[tuple[float, float], ...] = ()

    def region_model(self, records: int, record: NewRecord, points: tuple[RecordPoint, ...]) -> RegionModel:
        """What is known, as the new region model."""
        return _region_model(self.known, records, record.t_s, points, self.estimate)


def update_region_model(
    region_model: RegionModel | None,
    window: Window,
    in_force: PidGains,
    settings: TrackerSettings,
    fit: FitSettings,
    at: tuple[float, float] = (0.0, 0.0),
) -> Learned:
    """Take one record of a region into what is known of it.

    region_model : what was known, None at first; borrowed ones have no records.
    window : the record. in_force : gains under which it was taken: their direction is that of the process.
    at : where the record lay, in the table's scheduling variables.
    """
    sign = in_force.direction
    fits = Fits(window, (sign,), fit)
    through = valve_believed(window, sign, fits, fit)
    if through is not None:
        window, fits = through.window, through.fits
    plain = fits.estimate()
    alone = _seen_or_bounded(window, _in_danger_on_either(fits, plain, in_force, settings, fit), fit)
    record = NewRecord(window, fits.free, alone, at, settings, fit)
    learned = replace(_taken_in(region_model, record, in_force), contested=plain.is_contested(fit.apart_limit))
    return learned if through is None else replace(learned, valve=through.seen)


def _taken_in(region_model: RegionModel | None, record: NewRecord, in_force: PidGains) -> Learned:
    settings, fit, sign = record.settings, record.fit, in_force.direction
    if not teaches(record.alone, fit):
        kept = region_model if region_model is not None and region_model.records else None
        return Learned(kept, record.alone, Agreement.SILENT, 0.0)
    if region_model is None or region_model.log.sign != sign:
        return _first(record)
    settled = region_model.known if region_model.identifiable and region_model.records else None
    elapsed_s = record.t_s - region_model.t_s
    moving = (moved(k, region_model, elapsed_s, settings.walk_per_record, ahead=False) for k in region_model.known)
    posterior = _posterior_of(tuple(moving), elapsed_s, record)
    points = remembered(region_model.points, record.point(posterior.innovation, posterior.told))
    together = _together(region_model, record, points, in_force)
    if together is not None:
        return replace(together, innovation=posterior.innovation)
    if record.alone.identifiable and not posterior.estimate.identifiable and not _holds(region_model, record):
        return _first(record, settled)
    if posterior.innovation <= gate(len(region_model.log.x), settings.gate):
        # What was known explains the record; so may the alternative, and better
        alternative: tuple[StructureModel, ...] | None = None
        if region_model.alternative is not None:
            other = _posterior_of(region_model.alternative, 0.0, record)
            lead = posterior.rise - other.rise
            if other.innovation <= gate(len(region_model.alternative[0].log.x), settings.gate):
                if lead > settings.decisive:
                    changed = other.region_model(2, record, points[-2:])
                    return Learned(changed, other.estimate, Agreement.CHANGED, posterior.innovation)
                alternative = other.known if lead > -settings.decisive else None
        now = replace(posterior.region_model(region_model.records + 1, record, points), alternative=alternative)
        return Learned(now, posterior.estimate, Agreement.AGREES, posterior.innovation)
    if not region_model.records or (record.alone.identifiable and not _holds(region_model, record)):
        return _first(record, settled)
    return _contradicted(region_model, record, posterior.innovation, points, in_force)


def teaches(alone: ModelEstimate, fit: FitSettings) -> bool:
    """Whether a record shows the process at all, and no model without load steps explains it in another way."""
    return alone.explained >= fit.explained_limit and not alone.is_contested(fit.apart_limit)


def _in_danger_on_either(
    fits: Fits, alone: ModelEstimate, in_force: PidGains, settings: TrackerSettings, fit: FitSettings
) -> ModelEstimate:
    """What the record says by itself; where two models leave open what, but not that the loop is in danger, the first.

    A loop that is in danger on either model may be made safer, and is watched while it is.
    """
    if alone.rival is None or not alone.is_contested(fit.apart_limit):
        return alone
    both = (alone.log.model(), alone.rival.model)
    in_danger = all(sensitivity_peak(model.linear(), in_force) > settings.danger_ms for model in both)
    return fits.estimate(whatever_loads=True) if in_danger else alone


def _seen_or_bounded(window: Window, estimate: ModelEstimate, fit: FitSettings) -> ModelEstimate:
    """The estimate; where a setpoint step shows a dead time too short to be seen, with one of a sampling interval."""
    return bounded(window, estimate, fit) if setpoint_changes(window) else estimate


def _together(
    region_model: RegionModel, record: NewRecord, points: tuple[RecordPoint, ...], in_force: PidGains
) -> Learned | None:
    """The records so far and one that does not settle the process by itself, fitted as one; None where they are too
    many, of too different lengths, or not of one process.
    """
    few = region_model.windows and len(region_model.windows) == region_model.records
    if record.alone.identifiable or not few:
        return None
    windows = (*region_model.windows, kept(record.window))
    if not may_be_joined(windows):
        return None
    whole = joined(windows)
    fits = Fits(whole, (in_force.direction,), record.fit)
    found = _in_danger_on_either(fits, fits.estimate(), in_force, record.settings, record.fit)
    alone = record.alone.residual_std / unit_of(record.window)
    if not found.identifiable or found.residual_std > record.fit.hopeless * max(alone, 1.0):
        return None
    last = windows[-1]
    unit, began_s = unit_of(last), float(whole.t_s[-1]) - float(last.t_s[-1] - last.t_s[0])
    own = tuple(float(last.t_s[0]) + t - began_s for t in found.load_times_s if t > began_s)
    left, noise = found.residual_std * unit, found.noise_std * unit
    estimate = replace(found, load_times_s=own, residual_std=left, noise_std=noise)
    known = _led([StructureModel(scattered(a.log, record.settings), a.evidence) for a in found.alternatives], record)
    now = _region_model(known, len(windows), record.t_s, points, estimate)
    now = replace(now, windows=windows if len(windows) < MOST_RECORDS else ())
    return Learned(now, estimate, Agreement.AGREES, 0.0)


def _holds(region_model: RegionModel, record: NewRecord) -> bool:
    """Whether what was known stands up to a record that settles the process by itself."""
    if not region_model.identifiable:
        return False
    if region_model.records > 1 or region_model.alternative is not None:
        return True
    own = [point for point in region_model.points if point.t_s == region_model.t_s]  # later ones contradicted it
    return not own or own[-1].log.gain_uncertainty() < record.settings.clearer * record.alone.log.gain_uncertainty()


def _first(record: NewRecord, alternative: tuple[StructureModel, ...] | None = None) -> Learned:
    """The first record of a region: all that is known is what it says. alternative : what it took the place of."""
    alone = record.alone
    known = _led([StructureModel(scattered(a.log, record.settings), a.evidence) for a in alone.alternatives], record)
    log = known[0].log
    first = record.point(0.0, tuple(zip(log.x.tolist(), np.diag(log.p).tolist(), strict=True))[:TOLD])
    region_model = _region_model(known, 1, record.t_s, (first,), alone)
    region_model = replace(region_model, alternative=alternative, windows=(kept(record.window),))
    return Learned(region_model, alone, Agreement.FIRST, 0.0)


def _region_model(
    known: tuple[StructureModel, ...],
    records: int,
    t_s: float,
    points: tuple[RecordPoint, ...],
    estimate: ModelEstimate,
) -> RegionModel:
    told = estimate.plausible, estimate.identifiable, estimate.reason
    return RegionModel(known, records, t_s, None, points, *told, bound_s=estimate.bound_s)


def _contradicted(
    region_model: RegionModel, record: NewRecord, innovation: float, points: tuple[RecordPoint, ...], in_force: PidGains
) -> Learned:
    """The alternative confirmed, a loop in danger, or a contradicting record that waits."""
    alone, settings = record.alone, record.settings
    points = (*points[:-1], replace(points[-1], told=()))  # it tells of another process, or of none
    if region_model.alternative is not None:
        posterior = _posterior_of(region_model.alternative, 0.0, record)
        doubted = surprise_of(scattered(region_model.known[0].log, settings), alone)
        predicts = surprise_of(scattered(region_model.alternative[0].log, settings), alone) < doubted
        if predicts and posterior.innovation <= gate(len(region_model.alternative[0].log.x), settings.gate):
            changed = posterior.region_model(2, record, points[-2:])
            return Learned(changed, posterior.estimate, Agreement.CHANGED, innovation)
    if not alone.identifiable:
        return Learned(replace(region_model, alternative=None, points=points), alone, Agreement.CONTRADICTS, innovation)
    first = _first(record).region_model
    assert first is not None
    shown = [p.model for p in alone.plausible if not p.excess] or [alone.log.model()]
    if all(sensitivity_peak(model.linear(), in_force) > settings.danger_ms for model in shown):
        opened = replace(first, alternative=region_model.known, points=points)
        return Learned(opened, alone, Agreement.OPENED, innovation)
    waiting = replace(region_model, alternative=first.known, points=points)
    return Learned(waiting, alone, Agreement.CONTRADICTS, innovation)


def _posterior_of(known: tuple[StructureModel, ...], elapsed_s: float, record: NewRecord) -> Posterior:
    """Every structure updated by the record: its fits repeated with what is known in them."""
    settings, fit, alone = record.settings, record.fit, record.alone
    means = {k.log.type: grown(k, elapsed_s, settings) for k in known}
    priors = {t: scattered(mean.log, settings) for t, mean in means.items()}
    roots = {t: Prior.of(log.x, log.p) for t, log in priors.items()}
    before = {k.log.type: k.evidence for k in known}
    least = _loads_at_least(record)
    again = with_priors(record.found, roots, inflation_of, least)
    summed = [replace(c, criterion=c.criterion + before[c.fit.misfit.type]) for c in again]
    fitted = estimate_of(sorted(summed, key=lambda c: c.criterion), float(record.window.t_s[0]), roots, fit)
    estimate = _seen_or_bounded(record.window, fitted, fit)
    after = []
    for alternative in estimate.alternatives:
        type_ = alternative.log.type
        _, posterior = update(priors[type_], estimate)
        mean = back_to_mean(means[type_].log, priors[type_], posterior)
        after.append(StructureModel(mean, alternative.evidence))
    apart = min(_criterion(k, record) for k in known) + min(a.evidence for a in alone.alternatives)
    together = min(_criterion(k, record) for k in after)
    linear, _ = update(priors[known[0].log.type], alone)
    prior = priors[after[0].log.type]
    said = told(prior, update(prior, estimate)[1], settings.scatter)
    by_itself, best = record.found[0].fit.misfit, again[0].fit.misfit  # each needs the loads, and pays for them
    missing = max(least - by_itself.loads, 0) if best.loads >= least else 0
    rise = together - apart - load_price(by_itself) * missing
    return Posterior(_led(after, record), estimate, min(linear, max(rise, 0.0)), rise, said)


def _loads_at_least(record: NewRecord) -> int:
    """Loads that a record needs: one where the setpoint stood and pv begins within its noise, else none."""
    window, noise = record.window, record.found[0].fit.misfit.record.noise_std
    begins = np.abs(window.sp[:BEGINS] - window.pv[:BEGINS])
    return int(np.ptp(window.sp) == 0.0 and bool(np.all(begins <= RESTS_WITHIN * noise)))


BEGINS, RESTS_WITHIN = 3, 4.0
"""Samples with which a record begins, and noise standard deviations of pv within which it rests."""


def _criterion(known: StructureModel, record: NewRecord) -> float:
    """The evidence with the cost of the process parameters (Schwarz 1978)."""
    return known.evidence + len(known.log.x) * math.log(record.alone.best.samples)


def _led(known: list[StructureModel], record: NewRecord) -> tuple[StructureModel, ...]:
    """The leading structure first, the others no farther behind than is allowed."""
    ranked = sorted(known, key=lambda k: _criterion(k, record))
    lead, most = _criterion(ranked[0], record), record.settings.most_lead
    return tuple(replace(k, evidence=k.evidence - max(_criterion(k, record) - lead - most, 0.0)) for k in ranked)


def grown(known: StructureModel, elapsed_s: float, settings: TrackerSettings) -> StructureModel:
    """The region's mean one record and so much time later: widened by the random walk."""
    days = max(elapsed_s, 0.0) / SECONDS_PER_DAY
    return replace(known, log=widened(known.log, settings.walk_per_day**2 * days + settings.walk_per_record**2))


def on_the_way(settings: TrackerSettings, share: float) -> TrackerSettings:
    """The settings for a record along which the process went over a share of an axis, 0 for one that stood.

    One linear model of it stands for a process that is not the same at both ends of its way. By how much they differ,
    nobody knows before the curves do: of every logarithm, by their prior, 2 SLOPE_STD over the whole axis. Steps up and
    down differ by it, and the ends of a region, so records scatter by it about their mean.
    """
    return replace(settings, scatter=min(math.hypot(settings.scatter, 2 * SLOPE_STD * share), MOST_SCATTER))


def scattered(log: LogModel, settings: TrackerSettings) -> LogModel:
    """What one record may show when this is known of the mean, or the other way round."""
    return widened(log, settings.scatter**2)


def predicted(region_model: RegionModel, t_s: float, settings: TrackerSettings) -> LogModel:
    """The process as it may be met at a later time, for which the guard has to prove."""
    return _predicted(region_model, region_model.known[0], t_s, settings).at_bound(region_model.bound_s)


def predicted_all(region_model: RegionModel, t_s: float, settings: TrackerSettings) -> tuple[LogModel, ...]:
    """The prediction under every structure, the leading one first."""
    return tuple(_predicted(region_model, known, t_s, settings) for known in region_model.known)


def _predicted(region_model: RegionModel, known: StructureModel, t_s: float, settings: TrackerSettings) -> LogModel:
    elapsed_s = t_s - region_model.t_s
    known = moved(known, region_model, elapsed_s, settings.walk_per_record, ahead=True)
    return scattered(grown(known, elapsed_s, settings).log, settings)
