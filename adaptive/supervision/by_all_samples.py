"""All samples, not only those of recognised responses: what the book of a region says, and what follows.

    look_of                  so many samples since the last look: a question of its own, or with the response that
                             completes then
    proposal_by_all_samples  where the response cannot tell (none, nothing identifiable, a residual that no load step
                             explains, a record that contradicts) and the odds are clear: settings worth having over
                             the book, proved, on trial, with a sentence; more action is proved on what responses have
                             shown as well
    objection                where gains are to change, and the book speaks against it; then it may propose itself
    robust_by_all_samples    a trial's response that swings under a load that wanders or a tone, on processes on which
                             the tried set is robust; refuted_by_trial: what its own samples say against it

The book proposes nothing where the output stands at a limit, where a valve may not follow, or where clear steps have
shown the process and the loop mostly rests.
"""

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from retuner.adaptive.choice.expected_cost import ChoiceNumbers, percent
from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis
from retuner.adaptive.diagnosis.cause import MOST, Cause, Diagnosis
from retuner.adaptive.diagnosis.second_opinion import Excitation, runs_away
from retuner.adaptive.explanations.book import MOST_ROOM, MS_OF_ROOM, ODD, Book, doubted, heard, update, with_response
from retuner.adaptive.explanations.likely_processes import cost_on, costs
from retuner.adaptive.explanations.process_grid import EVERY_LAG
from retuner.adaptive.explanations.settings_by_book import (
    MS_SHOWN,
    BookNumbers,
    BookSettings,
    ByBook,
    bears,
    by_book,
    faster,
    gain,
    lets_go,
    shares,
    worth_of,
)
from retuner.adaptive.explanations.tone import tone_of
from retuner.adaptive.explanations.wandering_load import TEMPER, Prepared, lead_of_steps, log_likelihoods
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.request import Evidence
from retuner.adaptive.guard.ruling import Proof
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.confirmation import (
    doubt_of,
    exempt_from_confirmation,
    is_known,
    runaway,
    valve_explains_more,
)
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import Findings
from retuner.adaptive.supervision.judge_evidence import AGREED, may_follow
from retuner.adaptive.supervision.known_processes import KnownProcesses, on_models, unproved_request
from retuner.adaptive.supervision.question import OTHER_LOOP, Look
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.phase import TrialPhase
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.table import Lookup

LOOKED = "looked"  # Code: all samples were looked at, without a response
OPEN = frozenset({
    LOOKED, "not_identifiable", "unconfirmed", "unknown", "low_excitation", "contradicted", "one_record",
    OTHER_LOOP, "setpoint_led", "too_long",
})  # fmt: skip
"""Codes of outcomes that cannot tell."""
LOOK, WHOLE = 500, 1000
"""Samples of the book's interval after which it is looked at, and after which a window is entered for good."""
PER_TAU_I = 100
"""Samples of the book's interval in the integral time in force: lags and dead times of the grid reach round that."""
STRETCHED = 4.0  # factor by which an interval may be off before the book is begun anew


def interval_s(gains: PidGains, sample_time_s: float) -> float:
    """The interval in which a loop's book counts."""
    tau_i = abs(gains.kp / gains.ki) if gains.kp and gains.ki else 0.0
    return max(round(tau_i / sample_time_s / PER_TAU_I), 1) * sample_time_s


def look_after_s(gains: PidGains, sample_time_s: float, history: int) -> float:
    """Time after which all samples are looked at again; some windows of it are kept."""
    return min(LOOK * interval_s(gains, sample_time_s), history / KEPT_LOOKS * sample_time_s)


KEPT_LOOKS = 4  # looks that the samples which are kept must hold


def look_of(
    samples: Sequence[LoopSample], book: Book | None, gains: PidGains, since_s: float, after_s: float, dt_s: float,
    on_trial: bool, due: bool = True,
) -> Look | None:  # fmt: skip
    """What is to be looked at, of all samples that are kept; None where it is too little. since_s : since when the loop
    is in its region. on_trial : a set is judged, and what it did meanwhile must be among it, however little. due : see
    Look.
    """
    wanted = interval_s(gains, dt_s)
    if book is not None and (book.direction != gains.direction or not 1 / STRETCHED <= book.dt_s / wanted <= STRETCHED):
        book = None
    first_s = max(since_s, -math.inf if book is None else book.t_s)
    most = round(WHOLE / LOOK * after_s / dt_s)
    rows = [sample for sample in samples if sample.t_s > first_s]
    fewest = FEWEST_SAMPLES_ON_TRIAL if on_trial else max(FEWEST_SAMPLES, math.ceil(after_s / dt_s))
    if len(rows) < fewest:
        return None
    # Samples in windows of so many at the most. Where the setpoint moves in the later half of one, after it has stood,
    # the next begins: half an answer tells little, and the other half nothing without what co did before
    before, ends = round(most * PER_TAU_I / WHOLE), [0]
    moved = [0, *(at for at in range(1, len(rows)) if rows[at].sp != rows[at - 1].sp)]
    begun = [at - before for last, at in itertools.pairwise(moved) if at - last >= before]
    while ends[-1] < len(rows):
        nearest = (at for at in begun if most // 2 - before <= at - ends[-1] <= most)
        ends.append(min(next(nearest, ends[-1] + most), len(rows)))
    *earlier, last = [rows[first:end] for first, end in itertools.pairwise(ends)]
    if earlier and len(last) < fewest:  # too few by themselves: they come with the next
        *earlier, last = earlier
    grows = last[-1] is rows[-1] and len(last) < ROUNDED * most
    limited = sum(1 for sample in rows if sample.limited) / len(rows)
    windows, swings = tuple(Window.of(part) for part in earlier), tuple(map(_between_limits, (*earlier, last)))
    return Look(book, Window.of(last), grows=grows, limited=limited, due=due, earlier=windows, swings=swings)


def _between_limits(part: Sequence[LoopSample]) -> bool:
    """Whether the output goes from limit to limit; one that a setpoint step and the step back drive there does not."""
    sides = [sample.limited for sample in part if sample.limited]
    return sum(one != other for one, other in itertools.pairwise(sides)) >= TURNS


TURNS = 3  # from one limit to the other, of a swing between them; a step out and back makes two


FEWEST_SAMPLES, FEWEST_SAMPLES_ON_TRIAL = 300, 50  # samples of a look
ROUNDED = 0.99


@dataclass(frozen=True, slots=True)
class AllSamples:
    """What all samples say beside a response.

    look : those looked at now, None for none. book : the region's, with them; changed : whether it is another one than
    before. told : what the book says of the gains in force, None where it is not asked. shown : whether clear setpoint
    steps have shown the process: without a look the book then says only what it is sure of.
    """

    look: Look | None = None
    book: Book | None = None
    changed: bool = False
    told: ByBook | None = None
    shown: bool = False

    @property
    def by_loads(self) -> bool:
        """Whether loads alone have moved the loop."""
        return self.book is None or not self.book.told_by_setpoint

    @property
    def silent(self) -> bool:
        """Whether the book says nothing but what it is sure of."""
        return self.look is None and self.shown

    def entered(self, winner: Outcome) -> Outcome:
        """The outcome with the book as it is now, and what that says."""
        book, told = self.book, self.told
        if book is not None and told is not None and not self.silent:
            winner = replace(winner, all_samples=told.numbers)
            if self.look is not None:
                early = self.look.grows and told.leans < 0  # half a window calls a good loop too tight now and then
                book = book if early else replace(book, leans=told.leans)
            if winner.code == LOOKED:
                winner = replace(winner, reason=f"{winner.reason}; {told.words}")
        return replace(winner, book=book) if self.changed else winner


def all_samples(found: Findings, own: Outcome) -> AllSamples:
    """What does the book of the region say, of all samples up to now? own : what follows from the response."""
    look, settings, record = found.question.look, found.settings.book, found.record
    book, shown = record.book, shown_clearly(record.region_models.get(record.region), record.excitation, record.foreign)
    gains, dt_s = record.in_force, found.settings.sample_time_s
    changed = found.learned is not None and found.learned.agreement is Agreement.CHANGED
    if book is not None and changed:
        book = doubted(book, settings.changed_odds)
    doubts = not shown or own.code in OPEN - {LOOKED} or found.question.trial.phase is TrialPhase.TRIAL
    if look is not None and not ((look.due and doubts) or own.changes):
        look = None  # a look is dear
    if look is not None:
        first_s = float((*look.earlier, look.window)[0].t_s[0])
        book = (look.book or Book.begun(gains, interval_s(gains, dt_s), first_s)).under(gains)
        book = _with(look, doubted(book, settings.changed_odds) if changed else book, settings.hazard_s)
    learned, other = found.learned, record.crossed or found.joined  # not of this region, or not of one response
    if book is not None and learned and not other and (look is not None or own.changes):
        book = with_response(book, record.window, learned.estimate) if learned.estimate.identifiable else book
    external = own.diagnosis is not None and own.diagnosis.cause is Cause.EXTERNAL  # else a swing of the loop's own
    if book is not None and (external or (found.foreign is not None and found.foreign < record.foreign)):
        book = heard(book, MOST[Cause.EXTERNAL], tone=external)
    seen = AllSamples(look, book, book is not record.book, None, shown)
    asked = book is not None and (own.changes or not seen.silent)
    if book is None or not asked:
        return seen
    return replace(seen, told=by_book(book, gains, settings))


def _with(look: Look, book: Book, hazard_s: float) -> Book:
    """The book with what is looked at."""
    windows = (*look.earlier, look.window)
    for window, swings in zip(windows, look.swings or (False,) * len(windows), strict=True):
        grows = look.grows and window is look.window
        book = update(book, window, hazard_s=hazard_s, grows=grows, swings=swings)
    return book


def objection(found: Findings, own: Outcome, seen: AllSamples) -> Outcome | None:
    """The outcome without its change, where the book speaks against that; None where it does not.

    Less action is slower for certain, so it must be better on most of the book, and its cause at least as likely there
    as not, unless the change leads back: diagnose says the same of the same samples (cause_odds/). More action must do
    no harm by models and book together, which weigh the same: loads may be steps, or one may wander. Its cause is room,
    or, where a setpoint step is among the samples, that they bear this change itself. Where a loop whose process was
    shown mostly rests, no load wanders, and the book must be sure. It must hold half a whole window, or know the
    process by its setpoint, with the output between its limits, but not where less action comes from a model that
    is not identifiable. In a swing that grows, or goes between limits, it objects only where the process runs away:
    a walk explains a few large waves of an unstable loop as well. A clear response whose fit is likelier than every
    process of the book is of one between the points of its grid, or of what the process has become by now.
    """
    settings, book, told, proof = found.settings.book, seen.book, seen.told, own.proof
    record, look, shown = found.record, seen.look, seen.shown
    if book is None or told is None or proof is None or proof.gains is None or record.table.lookup is not Lookup.HARD:
        return None
    now, new, numbers, drawn = record.in_force, proof.gains, own.numbers, book.drawn(settings.drawn)
    less = abs(new.kp) < NEARLY * abs(now.kp) or abs(new.ki) < NEARLY * abs(now.ki)
    away = less and lets_go(drawn, now, new, settings)
    learned = found.learned
    grows = learned and runs_away(record.samples, record.response, learned.estimate.explained, found.settings.swing)
    if (grows or found.growth is not None or (look is not None and any(look.swings[-1:]))) and not away:
        return None
    half = look is not None and float(np.ptp(look.window.t_s)) >= LOOK * book.dt_s
    open_model = less and look and found.in_use and not found.in_use.identifiable
    followed = book.told_by_setpoint and not (look and look.limited > MOST_LIMITED)
    tells = away or book.records or half or followed or open_model
    more = told.numbers.book_room >= settings.more_odds or (not seen.by_loads and bears(drawn, now, new, settings))
    seen_so = seen.silent or (told.numbers.book_high >= HALF if less else more)
    worth, better = gain(drawn, now, new, settings)
    by_models = numbers.gain if isinstance(numbers, ChoiceNumbers) else 0.0
    sure = not (shown and (look is None or _rests(found, look))) or better < 1.0 - settings.less_odds
    worse = tells and sure and (better < settings.borne_out if less else by_models + worth < 0.0)
    steps = (away or worse or not seen_so) and _likelier_by_steps(found, book)
    borne_out = not seen.by_loads or (tells and better >= settings.borne_out)
    if not seen_so and not steps and (doubt := _doubt(found, own, proof, seen, less=less, borne_out=bool(borne_out))):
        return found.unconfirmed(own, replace(doubt, reason=f"{told.words}; {doubt.reason}"))
    bad = tells and not (less or shown) and shares(drawn, new, settings)[0] >= settings.less_odds
    if not (bad or ((away or worse) and not (steps and (less or found.clear)))):
        return None
    by_that = f"the change is better with {better:.0%} probability, its expected benefit {percent(worth)}"
    if away:
        by_that = f"the process runs away by itself with {float(drawn.weights @ drawn.runs_away):.0%} probability"
    reason = found.words(f"{told.words}; by that, {by_that}")
    return replace(own, code="unconfirmed", reason=reason, proof=None, basis=None, prediction=None)


def _doubt(
    found: Findings, own: Outcome, proof: Proof, seen: AllSamples, *, less: bool, borne_out: bool
) -> Diagnosis | None:
    """Why a change does not stand whose cause the book does not see; None where it does: the whole diagnosis must name
    the tuning, and no valve be likelier. That is not enough by loads alone where the change is not better on most of
    the book (borne_out), nor for a cut of both gains: the diagnosis knows no load that wanders, and a process that
    swings by itself explains such a load to the noise.
    """
    record, learned, new, now = found.record, found.learned, proof.gains, found.record.in_force
    if record.crossed or found.joined:  # not of this region, or not of one response
        return None
    if learned and found.in_use and exempt_from_confirmation(found, proof, learned, found.in_use):
        return None
    cut = less and new is not None and abs(new.kp) <= abs(now.kp) and abs(new.ki) <= abs(now.ki)
    if (cut or not borne_out) and learned is not None and not (found.clear or is_known(found, learned)):
        return Diagnosis(Cause.UNKNOWN, HALF, {}, NOT_SHOWN)
    if (doubt := doubt_of(found, own.diagnosis)) is not None:
        return doubt
    if seen.look is None or seen.book is None or not valve_explains_more(seen.look.window, seen.book, MOST_VALVE):
        return None
    return Diagnosis(Cause.STICTION, HALF, {}, "a valve that sticks or has play explains all samples better")


def _likelier_by_steps(found: Findings, book: Book) -> bool:
    """Whether a clear response, or one that agrees with what is known, is likelier by its fit, loads being steps, than
    by every process of the book's grid under a load that wanders, with or without a tone from outside: by its samples,
    weighed as in the book, as often as clear ones agreed, by how seldom a window is an odd one, and by the odds that no
    tone moves the loop: of a tone's waves steps make a process that swings.
    """
    learned, record = found.learned, found.record
    if learned is None or record.crossed or found.joined or not (found.clear or is_known(found, learned)):
        return False
    estimate, whole = learned.estimate, record.window.on_even_clock()
    n, window = len(whole.pv), Prepared.at(whole, book.dt_s)
    if len(window.pv) < FEWEST_ROWS:
        return True
    left = (1.0 - estimate.explained) * float(np.var(whole.pv)) * len(window.pv) / n
    tone = tone_of(whole, book.dt_s)
    each, _ = log_likelihoods(window, book.direction, book.unit, tone.columns, tone.taken, EVERY_LAG)
    likelihood = each - np.array(tone.prices)[:, None, None, None] / TEMPER
    lead = lead_of_steps(left, len(estimate.load_times_s), n, window, likelihood)
    alike = max(found.excitation_now.clear, 1) if learned.agreement is Agreement.AGREES else 1
    return alike * lead / TEMPER > math.log((1.0 - ODD) / ODD / max(1.0 - book.tone, ODD))


NOT_SHOWN = "no clear setpoint response has shown that"
HALF, FEWEST_ROWS = 0.5, 16
"""Odds of too high an Ms under which less action is doubted, and up to which a tone excuses a set on trial; intervals
of a response that a walk can be fitted to."""


def _rests(found: Findings, look: Look) -> bool:
    """Whether the error mostly lies within the noise band, so that no load wanders."""
    away = np.abs(look.window.sp - look.window.pv) > found.record.response.band
    return float(np.mean(away)) < found.settings.book.restless


NEARLY = 0.95  # share of an action down to which it is the same


def _may_speak(found: Findings, own: Outcome, look: Look, seen: AllSamples) -> bool:
    """Whether the case is the book's: the response cannot tell; or the setpoint has told the process, and no clear step
    has shown a response's model of it, this one among them.
    """
    record, cause = found.record, own.diagnosis.cause if own.diagnosis is not None else None
    if record.table.lookup is not Lookup.HARD or record.crossed or found.joined:
        return False
    if own.code not in OPEN and (seen.by_loads or seen.shown or found.clear or cause in {Cause.STICTION, Cause.NOISE}):
        return False
    stood = cause is Cause.SATURATION  # before the look began, too
    if stood or look.limited > MOST_LIMITED or not may_follow(found.question.trial, found.settings):
        return False
    return not (found.question.alone and record.admission(found.settings).ground in SPOILT)


SPOILT = frozenset({
    Ground.MANUAL, Ground.OUT_OF_RANGE, Ground.PV_STUCK, Ground.PV_CLIPPED, Ground.LOST_SAMPLES, Ground.IRREGULAR,
    Ground.REPEATED, Ground.LEFT_REGION, Ground.SATURATED,
})  # fmt: skip
"""What is wrong with a record of which nothing follows; of a response its admission has said so by then."""


def refuted_by_trial(found: Findings, own: Outcome, seen: AllSamples) -> Outcome | None:
    """The outcome with the book in doubt, where the samples of a trial by themselves speak against its set. By loads
    alone more action follows where the samples before spoke for it most, partly by chance: they prove no more.
    """
    trial, gains, settings = found.question.trial, found.record.in_force, found.settings
    old, dt_s = trial.old if trial.phase is TrialPhase.TRIAL and trial.new == gains else None, settings.sample_time_s
    if old is None or seen.look is None or seen.shown or not seen.by_loads or less_of_everything(old, gains):
        return None
    after_s = look_after_s(gains, dt_s, settings.history)
    look = look_of(found.record.samples, None, gains, trial.since_s, after_s, dt_s, on_trial=False)
    if look is None or seen.book is None:
        return None
    book = _with(look, Book.begun(gains, interval_s(gains, dt_s), trial.since_s), settings.book.hazard_s)
    told = by_book(book, gains, settings.book)
    if not book.records or told.numbers.book_high <= HALF or told.numbers.book_tone >= HALF:  # a part is sure too soon
        return None
    seen = replace(seen, book=doubted(seen.book, settings.book.changed_odds), changed=True)
    return seen.entered(replace(own, refuted=f"worse than predicted: by the samples of the trial alone, {told.words}"))


def robust_by_all_samples(found: Findings, winner: Outcome) -> bool:
    """Whether the set on trial is robust on next to all processes by all samples, those of its trial among them (with a
    look, now or before), and by loads alone, as answers before may be another process's: then a load that wanders
    explains a response that swings. Where the set is robust on most of them, so does a tone that moved the loop before,
    and a load where loads alone did, once the trial has lasted half a window.
    """
    numbers, settings, trial = winner.all_samples, found.settings.book, found.question.trial
    if numbers is None or not (book := winner.book or (found.record.book if trial.silent + trial.kept else None)):
        return False
    ran = float(found.record.window.t_s[-1]) - trial.since_s >= LOOK * book.dt_s
    if numbers.book_tone >= settings.less_odds or (ran and not book.told_by_setpoint):
        return numbers.book_high <= HALF
    by_loads = shares(replace(book, moved=0.0).drawn(settings.drawn), found.record.in_force, settings)[0]
    return max(numbers.book_high, by_loads) <= 1.0 - settings.less_odds


MOST_LIMITED = 0.02  # share of samples with the output at a limit up to which they show the loop


def shown_clearly(known: RegionModel | None, excitation: Excitation, foreign: int) -> bool:
    """Whether clear setpoint steps have shown the process, and nothing speaks against that."""
    return known is not None and known.identifiable and excitation.clear > 0 and not foreign


def others_may_tell(
    region: int, known: Mapping[int, RegionModel], own: Mapping[int, Excitation], foreign: Mapping[int, int]
) -> bool:
    """Whether responses elsewhere may change a region: none has ended in it, or its own have shown it clearly. Else
    what is known there is what its own did not confirm. own, foreign : excitation and foreign of ResponseRecord.
    """
    return region not in own or shown_clearly(known.get(region), own[region], foreign.get(region, 0))


def _by_responses(found: Findings, seen: AllSamples, told: BookNumbers) -> tuple[Plausible, ...] | None:
    """Models of responses that more action must bear as well, the likeliest first: by loads alone, that these are steps
    is one more hypothesis, under which it must do no harm. Samples with a setpoint step need none but what clear steps
    have shown. None where several records identify nothing, because co does nothing: a valve may stand.

    By loads alone a model counts by which Ms is good so far; where two records agree on it, or a clear step has shown
    it but a tone moves the loop, one whose Ms is within the odds of the book, too: of a tone's waves steps make a
    process that swings. Where none agree and these are sure of room, no model is asked.
    """
    record, settings = found.record, found.settings
    known, now = record.region_models.get(record.region), record.in_force
    if known is None:
        return ()
    agreed = known.records >= AGREED
    if not known.identifiable and agreed and known.plausible:
        much = PidGains(MOST_ROOM * now.kp, MOST_ROOM * now.ki, MOST_ROOM * now.kd)
        if _ms(known.plausible[0], much, settings) <= MS_OF_ROOM:
            return None
    if seen.shown and known.identifiable and told.book_tone < settings.book.less_odds:
        return known.plausible
    if not (seen.by_loads or seen.shown):
        return ()
    if known.identifiable and (agreed or seen.shown):
        most = max(told.book_ms_high, settings.book.ms_good)
        return tuple(one for one in known.plausible if min(_ms(one, now, settings), MS_SHOWN) <= most)
    asked = known.plausible if told.book_room < settings.book.sure_odds else ()
    return tuple(one for one in asked if _ms(one, now, settings) <= settings.book.ms_good)


def _ms(one: Plausible, gains: PidGains, settings: RetunerSettings) -> float:
    return sensitivity_peak(one.model.seen_by_controller(settings.sample_time_s).linear(), gains, settings.filter_s)


def proposal_by_all_samples(found: Findings, own: Outcome, seen: AllSamples) -> Outcome | None:
    """The change that is worth having over the book, proved as any other; None where the case is not the book's.

    own : what follows from the response, which is no change. More action is proved on models of responses as well; on
    the likeliest of these what is proved is to be worth a change, where clear steps have shown it.
    """
    look = seen.look
    if look is None or not _may_speak(found, own, look, seen) or (seen.shown and _rests(found, look)):
        return None
    return _proved_by_all_samples(found, own, seen)


def _proved_by_all_samples(found: Findings, own: Outcome, seen: AllSamples) -> Outcome | None:
    look, book, told = seen.look, seen.book, seen.told
    if look is None or book is None or told is None or told.tuning is None or not told.models:
        return None
    record, settings, region = found.record, found.settings, found.record.region
    less = told.leans < 0
    tight = told.numbers.book_high >= settings.book.less_odds
    if valve_explains_more(look.window, book, MOST_VALVE if tight else BY_CHANCE):
        return None
    also = () if less else _by_responses(found, seen, told.numbers)
    if also is None:
        return None
    known = KnownProcesses(record.table, record.region_models, float(record.window.t_s[-1]), settings)
    models = (*told.models, *(Plausible(one.model, 0.0) for one in also))
    asked = unproved_request(told.tuning, region, (record.table, record.commissioned), settings)
    asked = on_models(asked, known, region, models, Evidence(records=book.records + 1))
    proof = prove(asked, settings.guard)
    if not proof.accepted or proof.gains is None:
        return None
    sets = record.in_force, proof.gains
    if also and seen.shown:  # on the likeliest of them, how much less does it cost, ln?
        process = also[0].model.seen_by_controller(settings.sample_time_s).linear()
        stays, goes = (
            cost_on(process, _ms(also[0], one, settings), one, book.dt_s, settings.book.cost) for one in sets
        )
        if stays - goes < settings.book.worth:
            return None
    drawn = book.drawn(settings.book.drawn)
    if less and lets_go(drawn, *sets, settings.book):
        return None
    # Limits may leave a part of what was chosen that is worth nothing, or less: an action held, the other one cut
    before, after = (costs(drawn, one, settings.book.cost)[0] for one in sets)
    saves, sped = before - after, faster(*sets)
    worth = worth_of(drawn, saves, settings.book, more=not less, tone=book.untold_tone, faster=sped)
    if worth < settings.book.worth * proof.step:
        return None
    cause, odds, what = _cause_of(told, book, record.in_force, proof.gains, settings.book)
    words = f"{told.words}; {what} is expected to be worth {worth:.0%}"
    if own.code != LOOKED:
        words = f"{words} (this response by itself: {own.reason})"
    change = replace(
        own, code=proof.code, reason=found.words(words), proposal=told.tuning, proof=proof,
        diagnosis=Diagnosis(cause, min(odds, MOST_SURE), told.numbers.to_dict(), words), basis=Basis.ALL_SAMPLES,
        numbers=NO_NUMBERS, prediction=None,  # not those of a change that was dropped
    )  # fmt: skip
    doubt = runaway(found, proof)
    return change if doubt is None else found.unconfirmed(change, doubt)


def _cause_of(
    told: ByBook, book: Book, now: PidGains, new: PidGains, settings: BookSettings
) -> tuple[Cause, float, str]:
    """The cause that a change by all samples has, its odds, and what the change is in words."""
    if told.leans < 0:
        return Cause.AGGRESSIVE, told.numbers.book_high, "less action"
    gain_up, integral_up = abs(new.kp) > NEARLY * abs(now.kp), abs(new.ki) > NEARLY * abs(now.ki)
    better = gain(book.drawn(settings.drawn), now, new, settings)[1]
    if gain_up and integral_up:
        return Cause.SLUGGISH, better, "more action"
    cause, up, down = (
        (Cause.AGGRESSIVE, "gain", "integral action") if gain_up else (Cause.SLUGGISH, "integral action", "gain")
    )
    return cause, better, f"more {up} with less {down}"


MOST_VALVE, BY_CHANCE, MOST_SURE = 1.5, 0.5, 0.97
"""Tempered logarithm of the odds of a valve from which not even a lower Ms is sought, and up to which samples that show
none may speak for one; no cause is told surer."""
