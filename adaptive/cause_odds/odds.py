"""From the records of a loop to the odds of every cause: a load that wanders and jumps, a tone, or a few load steps.

    P(cause) = w P_steps(cause) + (1 - w) P_walk(cause)

P_walk     process, valve and a load that wanders or jumps too, by their likelihoods over all records and windows of the
           loop (explanations/): aggressive, slow integrating, sluggish, ok, stiction, nonlinear (the gain changes along
           pv); where a valve is in question, external: a load that repeats
P_steps    the verdict by one fit with its confidence (diagnosis/diagnose.py): a tone, or the loop by itself; and
           external, by the odds of a tone beside which the loop is robust
w          the odds that the record is what the second says: its fit against the walk, with a valve or without. The loop
           by itself counts where a few load steps leave white noise: no load of a plant does

A test in manual, co in steps, adds its likelihood. What needs no fit (a dead signal, manual, a relay, a controller that
acts the wrong way) stays as it is told. Records of one loop add up: one process, loads of their own.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from retuner.adaptive.cause_odds.compared_records import FEWEST_RECORD_SAMPLES, compared, windows_of
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.cause_odds.smoothed_record import with_smoothing
from retuner.adaptive.cause_odds.swinging_process import robust_on, swinging_processes
from retuner.adaptive.cause_odds.valve_evidence import shapes_of
from retuner.adaptive.controller_settings.summed_law import rough_law
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import tone_period_s
from retuner.adaptive.diagnosis.tuning_verdict import RecordVerdict, by_coincidence, not_brought_back
from retuner.adaptive.explanations.deciding_test import deciding_test, valve_test
from retuner.adaptive.explanations.gain_along_pv import GainAlongPv, gain_along_pv
from retuner.adaptive.explanations.likely_processes import quantile
from retuner.adaptive.explanations.periodic_load import log_odds_of_repeating
from retuner.adaptive.explanations.proposed_test import DecidingTest
from retuner.adaptive.explanations.settings_by_odds import Worthwhile, worthwhile
from retuner.adaptive.explanations.slip_odds import log_odds_of_slips
from retuner.adaptive.explanations.tuning_odds import TuningOdds, tuning_odds
from retuner.adaptive.explanations.valve_odds import WEIGHT, log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import TEMPER, Prepared, lead_of_steps
from retuner.adaptive.fit.record import setpoint_changes
from retuner.adaptive.fit.structure import model_at
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.indexes.condition import Condition, record_condition
from retuner.adaptive.indexes.recording_quality import held_together
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

FINAL = 0.9  # Confidence from which an unknown without any fit needs none


@dataclass(frozen=True, slots=True)
class Walk:
    """What the records say under a load that wanders.

    log_likelihood : of the grid's processes, records joined. valve : ln Bayes factor of a valve, tempered: of one band,
    or of slips at times of their own. along : what they say for a gain that changes along pv.
    record : the longest window as it was compared. of_record : the log-likelihood of that one, tempered as it comes.
    moved : largest share of setpoint or hand in what moves a record (wandering_load.py).
    repeats : ln Bayes factor of a load that repeats, tempered; where a valve is in question. period_s : of it, in the
    last record, nan for none.
    """

    log_likelihood: FloatArray
    valve: float
    along: GainAlongPv
    record: Prepared
    of_record: FloatArray
    moved: float
    repeats: float = -math.inf
    period_s: float = math.nan


@dataclass(frozen=True, slots=True)
class OddsFound:
    """The verdict with its odds, and what it rests on.

    found : of the record that the verdict rests on. tuning : processes and their odds, None without gains in force.
    settings : those worth having, where they come from the odds; None where the verdict's own hold, or none.
    record : which of the records that is.
    """

    found: RecordVerdict
    tuning: TuningOdds | None = None
    settings: Worthwhile | None = None
    record: int = 0


def diagnose_records(
    windows: Sequence[Window],
    gains: PidGains | None,
    co_min: float | None = None,
    co_max: float | None = None,
    *,
    direction: int | None = None,
    rough: PidGains | None = None,
    earlier: Sequence[PidGains | None] = (),
    settings: OddsSettings | None = None,
    diagnosis: DiagnosisSettings | None = None,
) -> OddsFound:
    """The odds of every cause behind the records of one loop.

    Parameters
    ----------
    windows : the records, one or more. gains : in force; without them only a valve can be told.
    co_min, co_max : limits of co where known. direction : sign of the controller's gain where no more is known.
    rough : gains that are known too badly for settings to follow, but well enough for odds.
    earlier : of a record that ran under other gains these, else None: it tells of process and valve alone.

    Returns
    -------
    OddsFound
        The most probable cause first in `found.diagnosis`, all causes in its `causes`, sum 1.
    """
    settings, diagnosis = settings or OddsSettings(), diagnosis or DiagnosisSettings(by_odds=True)
    own = earlier or (None,) * len(windows)
    each = [
        diagnose_window(w, one or gains, co_min, co_max, diagnosis, direction=direction, rough_law=rough_law)
        for w, one in zip(windows, own, strict=True)
    ]
    open_ones = [(w, f) for w, f in zip(windows, each, strict=True) if not _final(w, f)]
    if not open_ones:
        return OddsFound(_alone(each[0], settings))
    with_own = zip(windows, each, own, strict=True)
    now = [(w, f) for w, f, one in with_own if one is None and not _final(w, f)] or open_ones
    told = max((f for _, f in now), key=lambda f: (f.diagnosis.cause != Cause.UNKNOWN, f.diagnosis.confidence))
    at = next(i for i, f in enumerate(each) if f is told)
    sign = known.direction if (known := gains or rough) is not None else direction
    tests = [w for w, f in zip(windows, each, strict=True) if _final(w, f) and _in_steps(w)]
    asked = [*(w for w, _ in open_ones), *tests]
    signs = (sign,) if sign else (1, -1)
    walks = [w for one in signs if (w := _walk(asked, known, one, settings)) is not None]
    walk = min(walks, key=lambda w: w.valve, default=None)  # of either sign, where none is known
    if walk is None:
        return OddsFound(_alone(told, settings), record=at)
    odds = None
    if known is not None:
        odds = tuning_odds(walk.log_likelihood, known, walk.record.sample_time_s, settings.prior, settings.limits)
    by_shape = sum(shapes_of(f, settings) for _, f in open_ones)
    stepped = any(setpoint_changes(w) for w, _ in open_ones)  # what a valve does after a step may repeat as steps do
    if not stepped and (walk.valve > 0.0 or by_shape > 0.0):
        walk = max((_repeating(walk, [w for w, _ in open_ones], one) for one in signs), key=lambda w: w.repeats)
    tones = [_lasting_tone(f, settings) for _, f in now if stepped and "external" in f.fits]
    under_walk, whole = _under_walk(walk, odds, by_shape, settings, max(tones, default=0.0))
    under_steps, weight = _under_steps(now, under_walk, whole, walk, known, settings)
    causes = _mixed(under_steps, under_walk, weight, 1.0 - (1.0 - settings.most) / len(open_ones))
    verdict = _verdict(told, causes, weight, odds, walk, now, settings, (co_min, co_max), sure=gains is not None)
    return replace(verdict, record=at)


def _final(window: Window, found: RecordVerdict) -> bool:
    """Whether a record needs no likelihood: too short, mostly filled gaps, or no loop at work in it that is not led."""
    told = found.diagnosis
    holds = held_together(window.pv, window.co)
    if len(window.t_s) < FEWEST_RECORD_SAMPLES or (holds is not None and holds.share >= DiagnosisSettings().held_share):
        return True
    if found.fits or told.cause != Cause.UNKNOWN or told.confidence < FINAL:
        return told.cause == Cause.SATURATION or (told.cause == Cause.NOISE and not found.fits)
    return record_condition(window).condition != Condition.MOVING_SETPOINT


def _in_steps(window: Window) -> bool:
    """Whether a record is a test in manual: co goes in steps, and pv and co are alive. It says what the process is."""
    if len(window.t_s) < FEWEST_RECORD_SAMPLES or record_condition(window).condition != Condition.MANUAL:
        return False
    return bool(np.ptp(window.co) > 0.0 and np.ptp(window.pv) > 0.0)


def _alone(found: RecordVerdict, settings: OddsSettings) -> RecordVerdict:
    """A verdict that stands by itself; the odds that it leaves open are unknown's."""
    told = found.diagnosis
    p, other = min(told.confidence, settings.most), Cause.UNKNOWN
    if told.cause in {Cause.UNKNOWN, Cause.STICTION} and told.evidence.get("stand_degree"):
        odds = settings.stiction / (1.0 - settings.stiction) * math.exp(shapes_of(found, settings))
        p = min(odds / (1.0 + odds), settings.most)
        if told.cause == Cause.UNKNOWN and p > HALF:
            told = replace(told, cause=Cause.STICTION, confidence=p, reason=WORDS[Cause.STICTION])
        elif told.cause == Cause.UNKNOWN:
            p, other = 1.0 - p, Cause.STICTION
    causes = {told.cause: 1.0} if told.cause == other else {told.cause: p, other: 1.0 - p}
    shares = {str(cause): share for cause, share in causes.items()}
    return replace(found, diagnosis=replace(told, confidence=min(told.confidence, p), causes=shares))


def _walk(windows: Sequence[Window], gains: PidGains | None, direction: int, settings: OddsSettings) -> Walk | None:
    """All records and windows under a load that wanders, on one clock; None where nothing moves."""
    found = compared(windows, gains, direction, settings)
    if found is None:
        return None
    records = found.records
    seen = records
    if len(records) > len(windows):  # fewer and longer ones, of rows twice as far apart: a valve's cycles are slow
        longer = (part for w in windows for part in windows_of(w, 2.0 * found.dt_s, settings.most_windows // 2))
        coarser = (Prepared.at(part, 2.0 * found.dt_s) for part in longer)
        seen = tuple(with_smoothing(one, direction, None, settings.smooths)[0] for one in coarser)
    valve = log_odds_of_valve(seen, direction)
    slips = [WEIGHT * log_odds_of_slips(Prepared.at(w, w.sample_time_s), direction) for w in windows if valve < SEEN]
    if max(slips, default=UNSEEN) > UNSEEN:
        valve = max(valve, sum(max(one, UNSEEN) for one in slips))
    longest = max(range(len(records)), key=lambda i: len(records[i].pv))
    along = gain_along_pv(records, direction, found.powers)
    total = np.sum(found.weighed, axis=0)
    return Walk(total, valve, along, records[longest], found.each[longest], max(found.shares))


def _repeating(walk: Walk, windows: Sequence[Window], direction: int) -> Walk:
    """What all records say for a load that repeats; none does that one of them denies. direction : of the process."""
    found, period_s = 0.0, math.nan
    for window in windows:
        one, period_s = log_odds_of_repeating(Prepared.at(window, window.sample_time_s), direction)
        if one <= 0.0:
            return walk
        found += one
    return replace(walk, repeats=found, period_s=period_s)


UNSEEN, SEEN = -1.7, 6.9
"""Evidence of a record in which no valve with slips of its own is likelier: of one and the same, others may show it.
And of a valve of one band, from which none is looked for."""
MOST_SAID = 500.0  # ln Bayes factor of a valve that counts at the most: its exponential is a number


def _under_walk(
    walk: Walk, odds: TuningOdds | None, shapes: float, settings: OddsSettings, tone: float = 0.0
) -> tuple[dict[Cause, float], float]:
    """Odds under a load that wanders, and ln of how many times likelier loop, valve and load that repeats are than the
    loop alone. Whether the gain changes along pv is not asked where loads are steps.

    shapes : what shapes and plateaus say for a valve, in all records. tone : how far a tone that lasts moves pv beside
    setpoint steps.
    """
    linear = 1.0 - settings.stiction - settings.nonlinear - settings.repeats
    # Loads alone may bend a record, and no process that bends has a pv that stands while co travels
    bends = walk.moved >= settings.moved and shapes < math.log(settings.stands)
    along = walk.along.log_bayes if bends else min(walk.along.log_bayes, 0.0)
    said = {
        Cause.STICTION: math.log(settings.stiction) + min(walk.valve, MOST_SAID) + shapes,
        Cause.NONLINEAR: math.log(settings.nonlinear) + along,
        Cause.EXTERNAL: math.log(settings.repeats) + WEIGHT * walk.repeats,
        Cause.OK: math.log(linear),
    }
    whole = float(np.logaddexp.reduce(list(said.values())))
    straight = said | {Cause.NONLINEAR: -math.inf}
    beside_steps = float(np.logaddexp.reduce(list(straight.values())))
    p = {cause: math.exp(one - whole) for cause, one in said.items()}
    alone, repeats = p.pop(Cause.OK), p[Cause.EXTERNAL]
    if odds is None:
        return {**p, Cause.UNKNOWN: alone}, beside_steps - math.log(linear)
    # of a loop that has too little robustness the cause is not outside, whatever its load does
    tight = _less({Cause(name): one for name, one in odds.classes.items()})
    found = {Cause(name): one * (alone + repeats * (Cause(name) in LESS)) for name, one in odds.classes.items()}
    p[Cause.EXTERNAL] = repeats * (1.0 - tight)
    p[Cause.EXTERNAL] += tone * found[Cause.OK]  # a loop in order does not swing by itself
    found[Cause.OK] *= 1.0 - tone
    return {**p, **found}, beside_steps - math.log(linear)


def _under_steps(
    open_ones: Sequence[tuple[Window, RecordVerdict]],
    under_walk: Mapping[Cause, float],
    whole: float,
    walk: Walk,
    gains: PidGains | None,
    settings: OddsSettings,
) -> tuple[dict[Cause, float], float]:
    """Odds where loads are steps or a tone, over the records in which that is likely; and how likely it is there.

    whole : of `_under_walk`.
    """
    total: dict[Cause, float] = {}
    most = 0.0
    for window, found in open_ones:
        told = found.diagnosis
        outside = _tone_instead(found, gains, settings)
        lasts, loop, tone = _one_tone(window, found, settings) * math.exp(-whole), 0.0, 0.0
        if outside:
            tone = outside * _weight_of_steps(Cause.EXTERNAL, found, walk, whole, settings)
        if told.cause == Cause.UNKNOWN:
            tone = max(tone, lasts)
        else:
            loop = (1.0 - outside) * _weight_of_steps(told.cause, found, walk, whole, settings)
            loop = max(loop, lasts * (told.cause == Cause.EXTERNAL))
        weight = loop + tone
        if not weight:
            continue
        named, seen = loop / weight * told.confidence, tone / weight * max(outside, HALF)
        shares = {cause: (1.0 - named - seen) * p for cause, p in under_walk.items()}  # where steps are silent
        for cause, share in ((told.cause, named), (Cause.EXTERNAL, seen)):
            if share:
                shares[cause] = shares.get(cause, 0.0) + share
        for cause in dict.fromkeys((*shares, *total)):
            total[cause] = total.get(cause, 0.0) + weight * math.log(max(shares.get(cause, 0.0), 1e-6))
        most = max(most, weight)
    if not total:
        return {}, 0.0
    top = max(total.values())
    odds = {cause: math.exp(value - top) for cause, value in total.items()}
    return {cause: value / sum(odds.values()) for cause, value in odds.items()}, most


def _one_tone(window: Window, found: RecordVerdict, settings: OddsSettings) -> float:
    """How far a record is one lasting tone and nothing else, 0 to 1: one tone identifies no process, whatever fits it.

    A setpoint step is something else. A loop near instability under a real load wanders in amplitude and phase.
    """
    return 0.0 if setpoint_changes(window) else _lasting_tone(found, settings)


def _lasting_tone(found: RecordVerdict, settings: OddsSettings) -> float:
    """How far a tone that lasts, and is not the setpoint's, moves pv, 0 to 1."""
    if not _lasts(found):
        return 0.0
    share = found.diagnosis.evidence.get("tone_share", 0.0)
    return min(max((share - settings.tone_from) / (settings.tone_to - settings.tone_from), 0.0), 1.0)


def _tone_instead(found: RecordVerdict, gains: PidGains | None, settings: OddsSettings) -> float:
    """Probability that a tone from outside is the cause where loads are steps, and not the loop, which is robust on the
    process beside the tone. Where no setpoint step shows that process, it says nothing.

    With few cycles a tone is a load like any other, and what wanders always holds some sinusoid.
    """
    told, tone = found.diagnosis, found.fits.get("external")
    if told.cause not in {*TUNING_CAUSES, Cause.UNKNOWN} or tone is None or "external_lead" not in told.evidence:
        return 0.0
    misfit = tone.fit.misfit
    goes_on = misfit.record.span_s >= DiagnosisSettings().tone_cycles * tone_period_s(tone)
    if not goes_on or not _white(tone, settings.few_loads, settings):
        return 0.0
    if gains is not None and told.evidence.get("setpoint_steps"):
        model = model_at(misfit.type, tone.fit.x, misfit.sign).seen_by_controller(misfit.record.sample_time_s)
        if sensitivity_peak(model.linear(), gains) > settings.limits.ms_high:
            return 0.0
    lead = told.evidence["external_lead"] + by_coincidence(told.evidence)
    odds = settings.steps_weight * lead / (2.0 * TEMPER) + math.log(settings.repeats / (1.0 - settings.repeats))
    return 1.0 / (1.0 + math.exp(-min(max(odds, -50.0), 50.0)))


def _lasts(found: RecordVerdict) -> bool:
    """Whether an oscillation lasts."""
    return found.diagnosis.evidence.get("regularity", 0.0) > REGULAR


REGULAR = 1.0  # Regularity (Thornhill et al. 2003) from which an oscillation lasts.

BEHIND = {Cause.STICTION: "stuck", Cause.EXTERNAL: "external"}
"""The fit that a verdict rests on; the loop by itself for all others."""


def _white(fit: Candidate, most_loads: int, settings: OddsSettings) -> bool:
    """Whether a fit with few load steps leaves noise alone: no load that wanders leaves that."""
    noise = fit.fit.misfit.record.noise_std
    return fit.colour.std <= settings.noise_left * noise and fit.fit.misfit.loads <= most_loads


def _weight_of_steps(cause: Cause, found: RecordVerdict, walk: Walk, whole: float, settings: OddsSettings) -> float:
    """Probability that a tone, or a few load steps, are all that is behind a record, against all that `whole` counts.
    Where more is left than noise, and for a loop in order by loads alone, the load wanders and jumps.
    """
    tone = cause == Cause.EXTERNAL
    fit = found.fits.get("external" if tone else "linear")
    if fit is None:
        return settings.tone_alone if tone else HALF
    # a level that swings slowly shows it between any loads
    white = _white(fit, fit.fit.misfit.loads if cause == Cause.SLOW_INTEGRATING else settings.few_loads, settings)
    by_loads = walk.moved < settings.moved and cause == Cause.OK  # a slow process makes ramps of steps
    if not tone and (not white or by_loads or cause == Cause.STICTION):
        return 0.0
    misfit, record = fit.fit.misfit, walk.record
    left = float(np.mean((misfit.record.pv - fit.fit.at.explained) ** 2))
    left /= max(record.sample_time_s / misfit.record.sample_time_s, 1.0)
    steps = misfit.loads + misfit.harmonics
    lead = lead_of_steps(left, steps, len(misfit.record.pv), record, walk.of_record) / TEMPER
    most = 1.0 if white else settings.tone_alone
    if white and lead > 0.0 and (tone or not misfit.loads):
        # a slipping valve looks like load steps: beside one the loop by itself needs none
        lead *= settings.steps_weight
    if white and tone:
        lead = max(lead, 0.0)  # harmonics cost a tone much
    return most / (1.0 + math.exp(-min(max(lead - whole, -50.0), 50.0)))


HALF = 0.5  # Weight of a verdict by stretches, whose fits are not compared


def _mixed(steps: Mapping[Cause, float], walk: Mapping[Cause, float], weight: float, most: float) -> dict[Cause, float]:
    """Two sets of odds combined; no cause is surer than `most`, the others share the rest."""
    share = weight if steps else 0.0
    every = {cause: share * steps.get(cause, 0.0) + (1 - share) * walk.get(cause, 0.0) for cause in (*steps, *walk)}
    floor = (1.0 - most) / max(len(every) - 1, 1)
    every = {cause: max(p, floor) for cause, p in every.items()}
    total = sum(every.values())
    return dict(sorted(((c, p / total) for c, p in every.items()), key=lambda item: -item[1]))


def _verdict(
    told: RecordVerdict,
    causes: Mapping[Cause, float],
    weight: float,
    odds: TuningOdds | None,
    walk: Walk,
    open_ones: Sequence[tuple[Window, RecordVerdict]],
    settings: OddsSettings,
    limits: tuple[float | None, float | None],
    *,
    sure: bool,
) -> OddsFound:
    """The most probable cause, in words, with settings where they are worth having.

    limits : of co where known. sure : the gains in force are known, not roughly only.
    """
    cause, p = next(iter(causes.items()))
    shares = {str(c): q for c, q in causes.items()}
    by_fit = weight >= HALF and told.diagnosis.cause == cause and (told.tuning is None or p >= settings.due_odds)
    open_to_odds = sure and not (by_fit and told.tuning is not None)
    # an oscillation lasts and no setpoint step moved the loop: a load that oscillates may be all of it
    alone = not any(setpoint_changes(w) for w, _ in open_ones) and any(_lasts(f) for _, f in open_ones)
    worth, none = None, "" if sure else UNKNOWN_GAINS
    by_loads = walk.moved < settings.moved
    if odds is not None and open_to_odds:
        worth, none = _settings(causes, odds, walk.record, by_loads, alone, settings)
    if by_fit and (told.tuning is not None or worth is None):
        return OddsFound(replace(told, diagnosis=replace(told.diagnosis, confidence=p, causes=shares)), odds)
    evidence = {name: value for name, value in told.diagnosis.evidence.items() if name not in OF_ONE_MODEL}
    test, window = None, next(w for w, f in open_ones if f is told)
    if odds is not None:
        tone = told.fits.get("external")
        swing_s = tone_period_s(tone) if math.isnan(walk.period_s) and tone is not None else walk.period_s
        evidence |= _ms_range(odds) | ({} if math.isnan(swing_s) else {"swing_s": swing_s})
        # before gains change a step confirms what loads alone told
        if p < settings.undecided or (cause in TUNING_CAUSES and (worth is None or by_loads)):
            test = _next(causes, odds, walk, open_ones[0][0], limits, settings)
    if cause == Cause.NONLINEAR:
        evidence, test = evidence | {"gain_ratio": walk.along.ratio}, None
    reason = walk.along.sentence() if cause == Cause.NONLINEAR else _reason(cause, odds, evidence, told)
    reason = f"perhaps {reason}" if cause in WORDS and p < settings.due_odds else reason
    reason += not_brought_back(window) * (cause in {Cause.OK, Cause.SLUGGISH})
    overshoot = evidence.get("overshoot", 0.0)
    if cause not in BEHIND and overshoot > OVERSHOOTS and OVERSHOOT not in reason:
        reason += f"; its setpoint responses {OVERSHOOT} {overshoot:.0%}"
    if record_condition(window).condition == Condition.MOVING_SETPOINT:
        evidence |= _follows(window)
        reason += FOLLOWS.format(**evidence)
    settled = cause not in TUNING_CAUSES or worth is not None
    reason += "" if settled else f". No settings: {none}"
    verdict = Diagnosis(cause, p, evidence, reason, settled, shares, test)
    kept = replace(told, diagnosis=verdict, tuning=None, aim=None)
    return OddsFound(kept, odds, worth)


OF_ONE_MODEL = frozenset({"ms", "gm", "pm_deg", "ki_ratio", "kp_ratio"})
"""Evidence of a model that the verdict does not rest on."""


def _next(
    causes: Mapping[Cause, float],
    odds: TuningOdds,
    walk: Walk,
    window: Window,
    limits: tuple[float | None, float | None],
    settings: OddsSettings,
) -> DecidingTest | None:
    """The deciding test: a setpoint step, which shows tuning and valve, or steps of co where no such step decides.

    None for a loop that cannot be moved by its setpoint, whose error never moves, or where no test that co has room for
    is likely to decide. limits : of co where known.
    """
    error_std = float(np.std(window.sp - window.pv))
    if not (odds.gains.kp or odds.gains.ki) or not error_std > 0:
        return None
    up, down = _room(window.co, limits)
    valve = causes[Cause.STICTION] >= IN_QUESTION
    plain = valve or next(iter(causes.values())) >= settings.undecided
    test = deciding_test(odds, walk.record, error_std, max(up, down), PLAIN if plain else 0.0)
    return valve_test(odds, walk.record, float(np.std(window.co)), up) if test is None and valve else test


def _room(co: FloatArray, limits: tuple[float | None, float | None]) -> tuple[float, float]:
    """How far co may go up and down from where it was; without limits it is in percent, or the share of a whole."""
    low, high, usual = float(np.min(co)), float(np.max(co)), float(np.mean(co))
    likely = (0.0, 1.0 if high <= 1.0 else 100.0) if low >= 0.0 and high <= 100.0 else (-math.inf, math.inf)
    least, most = (likely[i] if one is None else one for i, one in enumerate(limits))
    return most - usual, usual - least


PLAIN = 4.0  # Usual errors of a step that confirms a cause which loads alone seem to show
IN_QUESTION = 0.05  # Odds of a valve from which it is asked for


def _settings(
    causes: Mapping[Cause, float],
    odds: TuningOdds,
    record: Prepared,
    by_loads: bool,
    swings: bool,
    settings: OddsSettings,
) -> tuple[Worthwhile | None, str]:
    """Settings worth having, of those that the odds of the causes ask for; else why there are none.

    by_loads : the setpoint hardly moves. Loads alone may pass for the loop's own doing: more action then takes larger
    odds, and less does where an oscillation lasts (swings). More must be robust on a process that swings by itself.
    """
    if next(iter(causes)) not in TUNING_CAUSES:
        return None, ""
    if causes.get(Cause.STICTION, 0.0) > settings.most_valve:
        return None, "the valve may stick, which hides the process"
    bends = causes.get(Cause.NONLINEAR, 0.0) > settings.nonlinear  # then more is too much elsewhere
    less, more, now = _less(causes), 0.0 if bends else causes.get(Cause.SLUGGISH, 0.0), odds.gains
    least, most = (settings.loads_odds if one else settings.due_odds for one in (swings, by_loads))
    own_swing = swinging_processes(record, now.direction) if more >= most else []

    def asked(new: PidGains) -> bool:
        if abs(new.kp) >= abs(now.kp) and abs(new.ki) >= abs(now.ki):
            return more >= most and robust_on(own_swing, new, odds.sample_time_s, settings.worth)
        # more gain under less integral action answers a sluggish loop as well; neither is then the likelier by itself
        return less >= least or less + more * (abs(new.kp) > abs(now.kp)) >= settings.loads_odds

    found = worthwhile(odds, settings.worth, asked) if less + more >= min(least, most) else None
    if found is not None:
        return found, ""
    if less >= least or more >= most:
        some = ", some of which swing by themselves" * any(p > settings.worth.bad_share for _, p in own_swing)
        return None, f"none is better on enough of the processes that the record allows{some}"
    if bends:
        return None, "the process gain may change along pv"
    if by_loads:
        return None, "the setpoint hardly moves, and loads alone do not show the tuning surely enough"
    return None, "the cause is not sure enough for a change"


UNKNOWN_GAINS = "the active settings are only known roughly"


def _less(causes: Mapping[Cause, float]) -> float:
    """Odds of the causes that ask for less action."""
    return sum(causes.get(cause, 0.0) for cause in LESS)


LESS = (Cause.AGGRESSIVE, Cause.SLOW_INTEGRATING)


def _ms_range(odds: TuningOdds) -> dict[str, float]:
    """Ms with the gains in force: the middle of its odds, and where nine of ten lie."""
    peaks, weights = odds.robustness.ms.ravel(), odds.weights.ravel()
    kept = weights > 1e-9 * float(weights.max())
    peaks, weights = np.minimum(peaks[kept], MS_SHOWN), weights[kept] / float(weights[kept].sum())
    low, middle, high = (quantile(peaks, weights, share) for share in (0.05, 0.5, 0.95))
    return {"ms": middle, "ms_low": low, "ms_high": high}


MS_SHOWN = 20.0  # A larger Ms, and an unstable loop, is told as this

OVERSHOOTS, OVERSHOOT = 0.25, "overshoot by"  # Overshoot from which it is told with a verdict

WORDS = {
    Cause.OK: "the tuning is in order",
    Cause.AGGRESSIVE: "too much gain",
    Cause.SLOW_INTEGRATING: "too much integral action for this gain",
    Cause.SLUGGISH: "the loop could be much faster",
    Cause.STICTION: "a valve that sticks or has play explains the record best",
}


SWINGS = "a load from outside that swings at about {swing_s:.3g} s explains the record best"
FOLLOWS = (
    "; a slave of a cascade: pv follows its setpoint {follows_late_s:.3g} s late, error {tracking_error:.0%} of it"
)


def _follows(window: Window) -> dict[str, float]:
    """How a slave tracks: the delay at which pv is most like its setpoint, and the error's share of its movement."""
    sp, pv = window.sp, window.pv
    apart = [float(np.std(pv[late:] - sp[: len(sp) - late])) for late in range(max(len(sp) // MOST_LATE, 1))]
    error = float(np.std(sp - pv)) / max(float(np.std(sp)), LEAST_MOVED)
    return {"follows_late_s": int(np.argmin(apart)) * window.sample_time_s, "tracking_error": error}


MOST_LATE, LEAST_MOVED = 10, 1e-300
"""Share of a record, one in so many, by which a slave may be late; a led setpoint moves at least so much."""


def _reason(cause: Cause, odds: TuningOdds | None, evidence: Mapping[str, float], told: RecordVerdict) -> str:
    """The sentence."""
    swing_s = evidence.get("swing_s", evidence.get("period_s"))
    if cause == Cause.EXTERNAL and told.diagnosis.cause != cause and swing_s is not None:
        return SWINGS.format(swing_s=swing_s)
    if cause not in WORDS:
        return told.diagnosis.reason
    if cause == Cause.STICTION or odds is None:
        return told.diagnosis.reason if told.diagnosis.cause == cause else WORDS[cause]
    low, middle, high = (evidence[name] for name in ("ms_low", "ms", "ms_high"))
    most = "or more" if high >= MS_SHOWN else f"to {high:.2f}"
    band = f" (90 % range {low:.2f} {most})" if f"{low:.2f}" != f"{high:.2f}" else ""
    return f"{WORDS[cause]}: Ms {middle:.2f}{band} with the active gains"
