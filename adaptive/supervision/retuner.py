"""The retuner: one sample in, now and then one decision out.

    sample -> finder -> completed response -> decide -> decision -> trial -> kept or rolled back

The object is a thin shell round pure steps. It hands out decisions, and learns by `committed` what is then in force.
A decision may take longer than a sample. `observe` makes it on the spot; whoever cannot wait takes its three steps:
    step(sample)                    a decision that needs no fit, or a Question, or nothing
    decide(question)                the answer: a pure function of plain values, anywhere (decide.py)
    enter(question, result, n)      the decision, entered at the n-th sample

Between the first and the last samples go on; a response that completes is passed over, a late answer refused.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.explanations.book import Book
from retuner.adaptive.explanations.settings_by_book import lets_go
from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import predicted
from retuner.adaptive.signals.recogniser import RecogniserState
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import LoopMode, LoopSample, plain
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.by_all_samples import look_after_s, look_of, others_may_tell, shown_clearly
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import (
    WRITES,
    Action,
    Decision,
    Delay,
    Mode,
    Outcome,
    blocked,
    predicted_wrongly,
    proposing,
    restoring,
    staying,
)
from retuner.adaptive.supervision.judge_evidence import prediction_of, seen_of
from retuner.adaptive.supervision.known_processes import KnownProcesses, known_of
from retuner.adaptive.supervision.question import (
    NOBODY,
    NOT_EVALUATED,
    NOTHING,
    Ended,
    Look,
    OpenQuestion,
    Question,
    ResponseRecord,
    RetunerState,
    SetpointLed,
    Step,
    left,
    not_evaluated,
    overtaken_by,
    passed_over,
    said,
)
from retuner.adaptive.supervision.response_finder import Completed, Left, ResponseFinder
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.judge import Judgement, TrialFinding
from retuner.adaptive.trial.phase import TO_BE_SEEN, UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, StillAllowed
from retuner.adaptive.trial.supervisor import TrialSupervisor
from retuner.adaptive.trial.words_on_persons_edit import NOT_TAKEN, edit_words, require_action
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable, Lookup

PATIENCE = 2.0  # without a response, all samples are looked at after so many times the usual wait


class Retuner:
    """Watches one loop and decides.

    Parameters
    ----------
    table : regions and the gains in force in each; the attribute of that name is the table as it stands.
    settings : see RetunerSettings. commissioned : the table as it was at first, when `table` is a later revision of it.
    """

    def __init__(self, table: GainTable, settings: RetunerSettings, commissioned: GainTable | None = None) -> None:
        self.settings = settings
        self.table, self.commissioned = table, commissioned or table
        self.region_models: dict[int, RegionModel] = {}
        self.foreign: dict[int, int] = {}
        self.excitation: dict[int, Excitation] = {}
        self.books: dict[int, Book] = {}
        self._finder = ResponseFinder(table.regions, self._gains_at, settings)
        self._observe = self._finder.step
        self.trials = TrialSupervisor(
            settings.trial, settings.sample_time_s, self._into_table, self._still_allowed, self._person_decides,
            settings.pv_range,
        )  # fmt: skip
        self._decisions, self._led = 0, SetpointLed()
        self._looked_s = self._alone_s = -math.inf  # when all samples were looked at, and are to be without a response
        self._open: OpenQuestion | None = None
        self._due: Mapping[int, Outcome] = {}
        self.sample_number = 0  # samples observed so far
        self.action_reversed = False  # whether the controller acts in the other direction: see operator_orders.acts

    @property
    def region(self) -> int | None:
        """Index of the region that the loop is in, None before the first sample."""
        return self._finder.region

    @property
    def scheduled(self) -> tuple[float, float]:
        """The scheduling values in force, x and x2: filtered, and the last good ones while one is not known."""
        return self._finder.scheduled

    @property
    def samples(self) -> list[LoopSample]:
        """The samples that are kept, the newest last."""
        return list(self._finder.samples)

    @property
    def recogniser(self) -> RecogniserState | None:
        """Where the recogniser stands, None before the first sample."""
        return self._finder.recogniser

    @property
    def at_rest(self) -> bool:
        """Whether no response is under way."""
        return self._finder.at_rest

    @property
    def band(self) -> float:
        """Noise band in pv units."""
        return self._finder.band

    def state(self) -> RetunerState:
        """Where it stands: see state_file.py, which turns it into plain values."""
        return RetunerState(self._finder.state(), self._decisions, self.sample_number, self._led, self._looked_s)

    def resume(self, state: RetunerState) -> None:
        """Go on from there. A question that was open is not any more: nobody may enter its answer."""
        self._finder.resume(state.finder)
        self._decisions, self.sample_number, self._led = state.decisions, state.samples, state.led
        self._looked_s, self._alone_s = state.looked_s, -math.inf
        self._open, self._due = None, {}

    def observe(self, sample: LoopSample) -> Decision | None:
        """Take one sample; a decision comes with the sample that completes a response.

        Raises
        ------
        ValueError
            A number of the sample is not finite or its time does not increase; nothing is changed then.
        """
        self._open = None  # of a question that Ctrl-C broke off: nobody will enter its answer
        asked = self.step(sample)
        if asked.question is None:
            return asked.decision
        try:
            result = decide(asked.question)
        except MemoryError as error:
            result = not_evaluated("all", error)
        return self.enter(asked.question, result, self.sample_number)

    def step(self, sample: LoopSample) -> Step:
        """Take one sample, and make what needs no fit of it; errors as `observe`.

        A question stays open until its answer is entered. A decision that comes with a question restores the verified
        set, and does not wait for what the response under way may teach.
        """
        if self.action_reversed:  # as in manual: the loop is not ours, and teaches nothing
            sample = plain(sample)._replace(mode=LoopMode.MANUAL)
        due, self._due = self._due, {}
        step = self._step_on_trial(plain(sample)) if self.trials.busy else self._step(sample)
        for region, outcome in due.items() if step == NOTHING else ():
            return Step(self._made_elsewhere(region, outcome))
        return step

    def _made_elsewhere(self, region: int, outcome: Outcome) -> Decision:
        """A change that is due where the loop is not; a trial that waits there is first ended as timed out."""
        ended = self.trials.away(region) and self.trials.event(region, TrialEvent.TIMED_OUT, self.now_s)
        if ended and self.trials.phase(region) is TrialPhase.RESTORING:
            return self._trial_ended({region: TrialEvent.TIMED_OUT})
        return self._on_trial(region, self._decision(region, outcome))

    def _step(self, sample: LoopSample) -> Step:
        seen = self._observe(sample)
        self.sample_number += 1
        if seen is None:
            return NOTHING if sample[0] < self._alone_s else self._looked()
        return self._seen(seen)

    def _looked(self) -> Step:
        """Where no response has completed for long, all samples are looked at by themselves."""
        region, look = self.region, self._look(alone=True)
        if look is None or region is None or self._open is not None:
            return NOTHING
        if self.settings.mode_of(region) == Mode.OFF:
            return NOTHING
        window = look.window
        if float(np.max(np.abs(window.sp - window.pv))) <= self.band:  # nothing but noise
            self._looked_s = self.now_s
            return NOTHING
        times = float(window.t_s[0]), float(window.t_s[-1])
        nothing = Response(*times, (), Ending.QUIET, bool(np.ptp(window.sp) > 0.0), self.band)
        return self._asked(Completed(region, nothing, self._finder.entered_s), alone=look)

    def _look(self, *, alone: bool = False, on_trial: bool = False) -> Look | None:
        """The samples to look at now, or None for none; sets when the next look is due.

        alone : no response has completed, and only a look that is due is worth one. on_trial : a trial waits for it.
        """
        region, samples, settings = self.region, self._finder.samples, self.settings
        if region is None or not samples or self.table.lookup is not Lookup.HARD:
            self._alone_s = math.inf if samples else -math.inf
            return None
        gains, since_s, dt_s = self.table.gains_of(region), self._finder.entered_s, settings.sample_time_s
        after_s = look_after_s(gains, dt_s, settings.history)
        if math.isinf(self._looked_s):
            self._looked_s = samples[0].t_s  # the first of all: the oldest that is kept moves on with time
        from_s = max(self._looked_s, since_s)
        self._alone_s = from_s + PATIENCE * after_s
        known, rests_on = self.region_models.get(region), self.excitation.get(region, Excitation())
        shown = shown_clearly(known, rests_on, self.foreign.get(region, 0))
        waited = on_trial or self.now_s >= from_s + (PATIENCE if alone else 1.0) * after_s
        if waited:
            self._alone_s = self.now_s + PATIENCE * after_s
        due = waited and not (alone and shown)
        if alone and not due:
            return None
        return look_of(samples, self.books.get(region), gains, since_s, after_s, dt_s, on_trial or not due, due)

    @property
    def open_question(self) -> Question | None:
        """The question whose answer has not been entered yet."""
        return self._open.question if self._open else None

    def enter(self, question: Question, result: Outcome, sample_number: int) -> Decision:
        """Enter the answer to the open question, after the sample of that number.

        An answer that was overtaken (see Overtaken) teaches and changes nothing. If a trial ended at the sample that
        raised the question and the answer comes at that same sample, the decision to restore is made again with what
        was learned, in place of the first one.

        Raises
        ------
        ValueError
            This question is not open, or the newest sample has another number.
        """
        if self._open is None or self._open.question.sample_number != question.sample_number:
            raise ValueError(f"the question of sample {question.sample_number} is not open")
        if sample_number != self.sample_number:
            raise ValueError(f"entered at sample {sample_number}, but the newest one is {self.sample_number}")
        opened, self._open = self._open, None
        phase = self.trials.phase(opened.question.record.region)
        overtaken = overtaken_by(opened, self.region, self._finder.samples, self.table, phase)
        if overtaken is not None:
            told = f"the decision came too late, after {opened.waited(self.sample_number)}: {overtaken}"
            refused = Outcome(f"overtaken_{overtaken.name.lower()}", told)
            return self._decision(opened.question.record.region, refused, opened.question)
        return self._learned_from_the_end(opened, result) if opened.ended else self._entered(opened.question, result)

    def committed(self, region: int, gains: PidGains) -> GainTable:
        """Take note that the controller now runs these gains in a region; returns the new table revision.

        gains : as read back from the controller (after its rounding).
        """
        given_up = self.trials.phase(region) in TO_BE_SEEN  # such a write may come through after all
        if self.trials.written(region, gains, self.now_s) or not given_up:
            self._change(region, gains)
        return self.table

    def not_written(self, region: int) -> None:
        """Take note that a change was not written, and that the controller runs what it ran."""
        self.trials.event(region, TrialEvent.NOT_WRITTEN, self.now_s)

    def abort(self, cause: TrialEvent) -> Decision | None:
        """Something happened that may end undecided trials; the decision on what is to run, None when there was none.

        The table has those sets when this returns. Action RESTORE: write them, and tell by `restored` that they run.
        """
        ended = self.trials.abort(cause, self.now_s)
        return self._trial_ended(dict.fromkeys(ended, cause)) if ended else None

    def edited(self, gains: PidGains) -> Decision | None:
        """Somebody else has set other gains where the loop is, and the controller runs them, as read back.

        They are a person's: the table takes them over, an undecided trial there is over, and for a stated time nothing
        but proposals follows (TrialSettings.edit_hold_s). None where they are what the table has, or before a sample.
        ValueError where they act in the other direction (see operator_orders.acts): no table holds such gains.
        """
        if (region := self.region) is None:
            return None
        require_action(gains, self.commissioned.gains[0])
        ours, at = self.table.gains_of(region), self._finder.scheduled
        if change_factor(self.table.at(region, *at), gains) <= SAME_GAINS:
            return None
        stored = self.table.stored_for(region, gains, *at)
        if stored is None:
            return self._decision(region, Outcome("edit_not_taken", NOT_TAKEN))
        on_trial = self.trials.phase(region) in UNDECIDED
        self._change(region, stored)
        self.trials.edited(region, stored, ours, self.now_s)
        hold_s = self.trials.of(region).until_s - self.now_s
        words = edit_words(ours, stored, self._still_allowed(region), hold_s, on_trial=on_trial)
        return replace(self._decision(region, Outcome("edited", words)), gains_before=ours, gains_after=None)

    def restored(self) -> tuple[int, ...]:
        """Take note that the controller runs the table's gains, as read back; the regions where that was awaited."""
        return self.trials.restored(self.now_s)

    def ordered(
        self, region: int, outcome: Outcome, gains: PidGains | None = None, prediction: Prediction | None = None
    ) -> Decision:
        """The decision on an order (see operator_orders.py): gains to be written, None when it is not done.

        prediction : what the gains are held to on trial; without a promise they are written and not on trial.
        """
        unpromised = prediction is None
        free = self.trials.may_change(region, self.now_s, urgent=unpromised, ordered=not unpromised)
        phase = self.trials.phase(region)
        free = free or (unpromised and phase in {TrialPhase.LOCKED, TrialPhase.HELD})
        if gains is not None and (self.action_reversed or not free):
            why = TrialEvent.ACTION_TURNED if self.action_reversed else phase
            gains, outcome = None, Outcome(f"held_{why.name.lower()}", f"no change now: {why}")
        decision = replace(self._decision(region, outcome), action=Action.NONE, gains_after=None, prediction=None)
        if gains is None:
            return decision
        if prediction is not None:
            self.trials.begin(region, decision.gains_before, gains, prediction, self.now_s, ordered=True)
        phase = self.trials.phase(region)
        return replace(decision, action=Action.WRITE, gains_after=gains, prediction=prediction, trial=str(phase))

    def rolled_back(self, region: int) -> Decision | None:
        """A change that is undecided, or waits for approval, is to be rolled back; None when there is none."""
        if reason := self.trials.no_rollback(region):
            return self.ordered(region, Outcome("revert_refused", f"rollback refused: {reason}"))
        back = self.trials.event(region, TrialEvent.ORDERED_BACK, self.now_s)
        return self._trial_ended({region: TrialEvent.ORDERED_BACK}) if back else None

    taken_back = rolled_back  # its former name

    @property
    def now_s(self) -> float:
        """Time of the newest sample, s; 0 before the first."""
        return self._finder.samples[-1].t_s if self._finder.samples else 0.0

    def _still_allowed(self, region: int) -> StillAllowed:
        """What is known of a region's process now. Nothing, where by the book it may run away by itself and the set
        on trial holds it worse than the one before: no model has an unstable pole, so all of them prefer less gain.
        """
        book, trial, asked = self.books.get(region), self.trials.of(region), self.settings.book
        if book and trial.old and trial.new and lets_go(book.drawn(asked.drawn), trial.old, trial.new, asked):
            return NOTHING_KNOWN
        rests_on, foreign = self.excitation.get(region, Excitation()), self.foreign.get(region, 0)
        shown = shown_clearly(self.region_models.get(region), rests_on, foreign)
        known = KnownProcesses(self.table, self.region_models, self.now_s, self.settings)
        tells = book and book.records and not shown and book.untold_tone < asked.tone
        return known_of(known, region, book if tells else None)

    def _person_decides(self, region: int) -> bool:
        """Whether a person has the next word on what is tried in a region."""
        return self.settings.mode_of(region) == Mode.TRIAL

    def _into_table(self, region: int, gains: PidGains) -> None:
        if self.table.gains_of(region) != gains:
            self._change(region, gains)

    def _gains_at(self, region: int, x: float, x2: float) -> PidGains:
        return self.table.at(region, x, x2)

    def _change(self, region: int, gains: PidGains) -> None:
        """The one place where the table changes; the count of other causes restarts, unless these gains ran before."""
        self.table = self.table.with_gains(region, gains)
        if gains not in self.trials.of(region).earlier:
            self.foreign.pop(region, None)
        if region == self.region or self.table.lookup is not Lookup.HARD:
            self._finder.gains_changed()

    def _step_on_trial(self, sample: LoopSample) -> Step:
        """A sample while a change is undecided, or being rolled back."""
        w, last_s, following = self._finder, self.now_s, self._finder.recogniser
        seen = self._observe(sample)
        self.sample_number += 1
        gap_s = self.settings.gap_samples * self.settings.sample_time_s
        blended = self.table.lookup == Lookup.INTERPOLATED
        ended = self.trials.watch(sample, w.region, w.band, sample.t_s - last_s, gap_s, blended=blended)
        if not ended:
            if seen is None:
                return NOTHING if sample[0] < self._alone_s else self._looked()
            return self._seen(seen)
        if seen is None and TrialEvent.RUNAWAY in ended.values():  # nothing teaches as much as this
            seen = w.cut_short(following)
        step = self._seen(seen, ended) if seen is not None else NOTHING
        return Step(self._trial_ended(ended, step.decision), step.question)

    def _learned_from_the_end(self, opened: OpenQuestion, result: Outcome) -> Decision:
        """The answer on a response with which a trial ended: what was forgotten comes back, and is judged with it."""
        ended, same = opened.ended, opened.question.sample_number == self.sample_number
        region = next(iter(ended))
        if opened.region_model is not None:
            self.region_models[region] = opened.region_model
        if opened.excitation is not None:
            self.excitation[region] = opened.excitation
        self._decisions -= same  # the decision to restore is made once more
        learned = self._entered(opened.question, result)
        if same:
            return self._trial_ended(ended, learned)
        if predicted_wrongly(self.trials.of(region), learned):
            self._forget(region)
        return learned

    def _trial_ended(self, ended: Mapping[int, TrialEvent], learned: Decision | None = None) -> Decision:
        """The decision on what is to run. learned : what the response under way has taught."""
        back = [region for region in ended if self.trials.phase(region) is TrialPhase.RESTORING]
        names = [self.table.regions.names[region] for region in back or ended]
        region = next(iter(back or ended))
        decision = learned or self._decision(region, Outcome("undo", ""))
        if back:
            return self._restoring(region, decision, names[1:])
        return staying(decision, names[0], self.trials.of(region), names[1:])

    def _restoring(self, region: int, decision: Decision, also: Sequence[str] = ()) -> Decision:
        trial = self.trials.of(region)
        if predicted_wrongly(trial, decision):
            self._forget(region)
        return restoring(decision, self.table.regions.names[region], trial, also)

    def _seen(self, seen: Completed | Left, ended: Ended = NOBODY) -> Step:
        """Something came to an end: what it asks, or the decision on it where nothing is asked.

        ended : trials that the same sample ended.
        """
        if isinstance(seen, Left):
            return Step(self._decision(seen.region, told)) if (told := left(seen, self.settings)) else NOTHING
        if self.settings.mode_of(seen.region) == Mode.OFF:
            return NOTHING
        return self._asked(seen, ended)

    def _asked(self, seen: Completed, ended: Ended = NOBODY, alone: Look | None = None) -> Step:
        """What a completed response asks, or all samples alone. ended : trials that the same sample ended."""
        region = next(iter(ended), seen.region)
        try:
            question = self._question(seen, news=bool(ended or self.trials.busy or alone), alone=alone)
        except Exception as error:  # noqa: BLE001  whatever the record is like, the next sample is taken
            return NOTHING if ended else Step(self._decision(seen.region, not_evaluated("question", error)))
        if question is None:
            return NOTHING
        if self._open is not None:
            told = f"the previous response was still being evaluated after {self._open.waited(self.sample_number)}"
            late = Outcome("passed_over", f"{told}: this one is not used to update the model")
            return NOTHING if ended else Step(self._decision(seen.region, late, question))
        self._open = OpenQuestion(
            question, self.table, ended, self.region_models.get(region), self.excitation.get(region)
        )
        return Step(None, question)

    def _question(self, seen: Completed, *, news: bool, alone: Look | None = None) -> Question | None:
        """What a completed response asks; None where it says only what was said lately. news : whatever it says.

        alone : no response has completed, and this is looked at.
        """
        others = [at for at in range(len(self.table.regions)) if self.settings.mode_of(at) in WRITES]
        others = [at for at in others if at != seen.region]
        told = [at for at in others if others_may_tell(at, self.region_models, self.excitation, self.foreign)]
        free = tuple(at for at in told if self.trials.idle(at, self.now_s))
        away = tuple(at for at in others if self.trials.away(at) and not self._person_decides(at))
        # Everything that the decision depends on
        w, response = self._finder, seen.response
        case = ResponseRecord(
            seen.region, response, w.window(response, seen.wander), tuple(w.samples), self.table, self.commissioned,
            dict(self.region_models), self.foreign.get(seen.region, 0), self.excitation.get(seen.region, Excitation()),
            w.scheduled, seen.entered_s, self._led.passed_over, self.books.get(seen.region),
        )  # fmt: skip
        if not news and passed_over(self._led, case, self.settings):
            self._led = self._led._replace(passed_over=self._led.passed_over + 1)
            return None
        trial = self.trials.of(seen.region)
        on_trial = trial.phase is TrialPhase.TRIAL
        look = alone or (self._look(on_trial=on_trial) if seen.region == self.region else None)
        self._looked_s = self._looked_s if look is None or not look.due else self.now_s
        return Question(case, self.settings, self.sample_number, trial, free, away, look, alone is not None)

    def _entered(self, question: Question, outcome: Outcome) -> Decision:
        """What the answer teaches is kept, a trial judged, and the decision made."""
        case, region = question.record, question.record.region
        self._led = said(self._led, case, outcome.code)
        if outcome.region_model is not None:
            self.region_models[region] = outcome.region_model
        self.region_models.update(outcome.beside)
        if outcome.book is not None:
            self.books[region] = outcome.book
        if outcome.foreign is not None:
            self.foreign[region] = outcome.foreign
        if outcome.excitation is not None:
            self.excitation[region] = outcome.excitation
        if outcome.forget:
            self._forget(region)
        judgement = None if question.alone and not outcome.refuted else self._judge(case, outcome)
        decision = self._decision(region, outcome, question, judgement)
        if judgement is not None and self.trials.phase(region) == TrialPhase.RESTORING:
            return self._restoring(region, decision)
        if decision.action == Action.NONE:
            self._due = outcome.elsewhere
        return self._on_trial(region, decision)

    def _on_trial(self, region: int, decision: Decision) -> Decision:
        now, prediction, proof = decision.gains_after, decision.prediction, decision.proof
        if decision.action != Action.WRITE or now is None or prediction is None:
            return decision
        urgent = proof is not None and proof.urgent
        self.trials.begin(region, decision.gains_before, now, prediction, self.now_s, urgent=urgent)
        return replace(decision, trial=str(self.trials.phase(region)))

    def _forget(self, region: int) -> None:
        self.region_models.pop(region, None)
        self.excitation.pop(region, None)

    def _judge(self, case: ResponseRecord, outcome: Outcome) -> Judgement | None:
        """The response against the promise, when it ran under gains on trial."""
        trial = self.trials.of(case.region)
        if trial.phase != TrialPhase.TRIAL or (case.crossed and outcome.posterior is None):
            return None
        if outcome.code in {Ground.SATURATED.name.lower(), NOT_EVALUATED}:
            silent = Judgement(TrialFinding.INCONCLUSIVE, outcome.reason, outcome.numbers)
            return self.trials.silent(case.region, silent, self.now_s, robust=outcome.robust)
        if outcome.refuted:
            self.trials.event(case.region, TrialEvent.WORSE, self.now_s)
            return Judgement(TrialFinding.WORSE, outcome.refuted, outcome.numbers)
        ask = self._person_decides(case.region)
        return self.trials.judge(case.region, seen_of(case, outcome), case.in_force, self.now_s, ask=ask)

    def _decision(
        self, region: int, outcome: Outcome, question: Question | None = None, judgement: Judgement | None = None
    ) -> Decision:
        """What follows from an outcome by mode and trial: a write or advice. question : that it answers, if any."""
        now_s, urgent = self.now_s, bool(outcome.proof and outcome.proof.urgent)
        proposes = self.trials.held_by_a_person(region, now_s)
        phase_allows = self.trials.may_change(region, now_s, urgent=urgent) or proposes
        if not phase_allows:
            outcome = blocked(outcome, self.trials.of(region), now_s)
        accepted = outcome.changes and phase_allows
        prediction = outcome.prediction
        if accepted and prediction is None:
            at, pattern = (question.record.at, question.record.pattern) if question else (self._finder.scheduled, None)
            prediction = prediction_of(
                outcome.proof, self.table, region, at, pattern, self.settings, self._finder.samples
            )
        learned, wanted = outcome.learned, Action.WRITE if self.settings.mode_of(region) in WRITES else Action.ADVISE
        model = learned.region_model if learned else None
        self._decisions += 1
        made = Decision(
            number=self._decisions,
            t_s=now_s,
            loop=self.table.loop,
            region=self.table.regions.names[region],
            mode=self.settings.mode_of(region),
            action=wanted if accepted else Action.NONE,
            code=outcome.code,
            reason=outcome.reason,
            gains_before=self.table.gains_of(region),
            gains_after=outcome.proof.gains if outcome.proof and accepted else None,
            response=question.record.response if question and not question.alone else None,
            estimate=learned.estimate if learned else None,
            agreement=learned.agreement if learned else None,
            records=model.records if model else 0,
            diagnosis=outcome.diagnosis,
            basis=outcome.basis,
            proposal=outcome.proposal,
            proof=outcome.proof,
            numbers=outcome.numbers,
            prediction=prediction if accepted else None,
            judgement=judgement,
            trial=str(self.trials.phase(region)),
            known=predicted(model, now_s, self.settings.tracker) if model else None,
            later=region != self.region and self.table.lookup is Lookup.HARD,
            all_samples=outcome.all_samples,
        )
        made = proposing(made, self.trials.of(region), now_s) if proposes else made
        if question is None or question.sample_number == self.sample_number:
            return made
        return replace(made, delay=Delay(question.sample_number, self.sample_number))
