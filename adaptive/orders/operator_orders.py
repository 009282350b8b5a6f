"""What people order, looked at once more before it is written: a proposal, theirs or approved, the way back, a lock,
a mode; and what they must not do at the controller: turn its action.

An approved proposal is put to the guard again, with what is known now, and is written whole or not at all: what was
approved is what was looked at. Where nothing is known of the region (the proposal is of the session before this one)
the limits per change hold it, but not on the way to less of everything: a proposal that calms may be as large as its
loop is unstable. Then it is on trial as any change. The way back leads to a set that has run before, so the limits per
change do not hold it; the absolute ones do, and a set that is likelier to be unstable than the active one is refused
(trial/rollback.py). While a change is on trial the way back is its rollback.
"""

from dataclasses import replace

import numpy as np

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.ruling import Proof
from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor, less_of_everything, within_limits
from retuner.adaptive.orders.pending_proposal import Proposal, ProposalStanding
from retuner.adaptive.region_model.update import update_region_model
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decision import Action, Decision, Mode, Outcome
from retuner.adaptive.supervision.findings import NOT_KNOWN, tuning_of
from retuner.adaptive.supervision.judge_evidence import prediction_of
from retuner.adaptive.supervision.known_processes import KnownProcesses, change_request, known_of
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import TO_BE_SEEN, UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.rollback import SetsThatRan, unstable_again
from retuner.adaptive.trial.words_on_persons_edit import right_words, turned_words
from retuner.schedule.gains import PidGains

WHOLE = 1.001
"""A proof that would let through another set than the approved one, by this factor, does not let that one through."""


def approve(retuner: Retuner, proposal: Proposal, t_s: float) -> Decision:
    """A person approved a proposal: the decision to write it, or why not. t_s : now.

    Raises ValueError: there is no such region.
    """
    region = retuner.table.index(proposal.region)
    proof = _proved(retuner, region, proposal.after, t_s)
    short, reason = proposal.digest[:8], _refusal(retuner, region, proposal, proof)
    if reason:
        return retuner.ordered(region, Outcome("approval_refused", f"proposal {short} is not written: {reason}"))
    prediction = Prediction.from_dict(proposal.prediction) if proposal.prediction else None
    outcome = Outcome("approved", f"proposal {short} of {proposal.t_s:,.0f} s was approved by an operator", proof=proof)
    return retuner.ordered(region, outcome, proposal.after, prediction)


def propose(retuner: Retuner, region: int, gains: PidGains, t_s: float) -> Decision:
    """A person proposes gains: a proposal like the retuner's own where the guard proves them whole, or why not.

    t_s : now. Nothing is written before the proposal is approved.
    """
    proof = _proved(retuner, region, gains, t_s)
    proved = None if proof is None else proof.gains
    if gains.direction != retuner.table.gains_of(region).direction:
        reason = "these gains have the opposite control action"
    elif proof is None:
        reason = "the process of this region is not known yet"
    elif proved is None:
        reason = proof.sentence
    elif change_factor(proved, gains) > WHOLE:
        reason = f"only a smaller change is proved now: kp {proved.kp:.4g}, ki {proved.ki:.4g}, kd {proved.kd:.4g}"
    else:
        prediction = prediction_of(proof, retuner.table, region, retuner.scheduled, None, retuner.settings)
        told = retuner.ordered(region, Outcome("order_proposed", "an operator proposed these gains", proof=proof))
        return replace(told, action=Action.ADVISE, gains_after=proved, prediction=prediction)
    return retuner.ordered(region, Outcome("order_refused", f"proposal refused: {reason}", proof=proof))


def approve_proposal(retuner: Retuner, decision: Decision, expires_after_s: float = 86400.0) -> Decision:
    """An operator approves what a decision proposes.

    Parameters
    ----------
    retuner : of the loop. decision : with action ADVISE. expires_after_s : how long it stands, s; default a day.

    Returns
    -------
    Decision
        To write it (do what it asks for, as with any decision), or why not.

    Raises
    ------
    ValueError
        The decision proposes nothing, it is older than that, or other gains became active meanwhile.
    """
    proposal = Proposal.of(decision)
    if proposal is None:
        raise ValueError("there is no proposal to approve")
    standing = proposal.standing(retuner.table.gains_of(proposal.region), retuner.now_s, expires_after_s)
    if standing is not ProposalStanding.OPEN:
        raise ValueError(f"this proposal cannot be approved: {standing}")
    return approve(retuner, proposal, retuner.now_s)


def _proved(retuner: Retuner, region: int, gains: PidGains, t_s: float) -> Proof | None:
    """The guard's word on a person's gains; None where nothing is known of the region."""
    if region not in retuner.region_models:
        return None
    wanted = Tuning("approved", "parallel", gains)
    known = KnownProcesses(retuner.table, retuner.region_models, t_s, retuner.settings)
    return prove(change_request(wanted, region, retuner.commissioned, known, None), retuner.settings.guard)


def _refusal(retuner: Retuner, region: int, proposal: Proposal, proof: Proof | None) -> str:
    """Why an approved proposal is not written; empty when it is."""
    in_force = retuner.table.gains_of(region)
    if proposal.prediction is None:
        return "it has no prediction to judge a trial by"
    if change_factor(in_force, proposal.before) > SAME_GAINS:
        return str(ProposalStanding.OTHER_GAINS)
    if proof is None:
        less = less_of_everything(in_force, proposal.after)
        moved = within_limits(in_force, proposal.after, 1.0, retuner.settings.guard, less_unlimited=less)
        whole = moved is not None and change_factor(moved[0], proposal.after) < WHOLE
        return "" if whole else "it is outside the present limits of a change"
    if proof.gains is None:
        return proof.sentence
    if change_factor(proof.gains, proposal.after) > WHOLE:
        return "with the present model only a smaller change is proved"
    return ""


def revert(retuner: Retuner, region: int, gains: PidGains, t_s: float) -> Decision | None:
    """A person wants gains back that were in force before: the decision to write them, or why not. t_s : now."""
    phase = retuner.trials.phase(region)
    if phase in UNDECIDED or phase is TrialPhase.WAITING:
        return retuner.rolled_back(region)
    # Why a region does not go back to these gains
    in_force, settings = retuner.table.gains_of(region), retuner.settings
    guard: GuardSettings = settings.guard
    if gains.direction != in_force.direction:
        reason = "these gains have the opposite control action"
    elif change_factor(gains, in_force) <= SAME_GAINS:
        reason = "they are active already"
    elif not guard.kc_min <= abs(gains.kp) <= guard.kc_max:
        reason = f"kc {gains.kp:g} lies outside kc_min and kc_max"
    else:
        known = known_of(KnownProcesses(retuner.table, retuner.region_models, t_s, settings), region)
        why = unstable_again(SetsThatRan(gains, in_force), known)
        reason = why.replace("the previous gains", "they")
    if reason:
        return retuner.ordered(region, Outcome("revert_refused", f"rollback refused: {reason}"))
    return retuner.ordered(region, Outcome("ordered_back", "an operator requested this rollback"), gains)


def accept(retuner: Retuner, region: int, t_s: float) -> bool:
    """A person approved what was tried and has passed; whether the region had been waiting for that."""
    return retuner.trials.event(region, TrialEvent.APPROVED, t_s)


def unlock(retuner: Retuner, region: int, t_s: float) -> bool:
    """A person lets a locked-out region change again; whether it had been locked."""
    return retuner.trials.event(region, TrialEvent.UNLOCKED, t_s)


def found_running(retuner: Retuner, gains: PidGains) -> Decision | None:
    """A session goes on from the memory of an earlier one, and the controller runs these gains, as read back.

    They tell how a write ended in which the earlier session did. What neither the table nor an undecided change has is
    an operator's.

    Parameters
    ----------
    retuner : as it was restored. gains : that the controller runs.

    Returns
    -------
    Decision or None
        An operator's edit (see `Retuner.edited`), or action RESTORE where other gains are to run; None where all is as
        it was remembered.

    Raises
    ------
    ValueError
        The gains act in the other direction than the commissioned ones.
    """
    region = retuner.region
    if region is None:
        return None
    trial, at = retuner.trials.of(region), (region, *retuner.scheduled)
    tried = trial.new is not None and same_gains(retuner.table.with_gains(region, trial.new).at(*at), gains)
    if trial.phase is TrialPhase.WRITING and tried and trial.new is not None:
        retuner.committed(region, trial.new)
        return None
    if trial.phase is TrialPhase.WRITING:
        retuner.not_written(region)
    if trial.phase in TO_BE_SEEN and (tried or same_gains(retuner.table.at(*at), gains)):
        again = retuner.ordered(region, Outcome("restore_again", f"a restart found {trial.phase}"))
        return replace(again, action=Action.RESTORE, gains_after=retuner.table.gains_of(region))
    return retuner.edited(gains)


def same_gains(one: PidGains, other: PidGains) -> bool:
    """Whether two sets differ by no more than a read-back does."""
    return one.direction == other.direction and change_factor(one, other) <= SAME_GAINS


def acts(retuner: Retuner, gains: PidGains) -> Decision | None:
    """These gains run, as read back, whoever set them: whether they act in the direction that was commissioned.

    Gains of the other sign turn negative feedback into positive. Until they are gone the loop is on hold: nothing may
    be written, nothing is learned, and they never enter the table. The decision says so, once; None where nothing has
    changed, or before the first sample.
    """
    region, turned = retuner.region, gains.direction != retuner.commissioned.gains[0].direction
    if region is None or turned == retuner.action_reversed:
        return None
    retuner.action_reversed = turned
    if not turned:
        return retuner.ordered(region, Outcome("action_right", right_words(gains)))
    ended = retuner.abort(TrialEvent.ACTION_TURNED)
    words = turned_words(retuner.table.gains_of(region), gains, on_trial=ended is not None)
    told = ended or retuner.ordered(region, Outcome("action_turned", words))
    return replace(told, action=Action.NONE, code="action_turned", reason=words, gains_after=None)


def set_mode(retuner: Retuner, region: int | None, mode: Mode) -> Decision | None:
    """A person says what may be done from now on in a region, None for all; off rolls back what is on trial there.

    The decision to roll it back, None when nothing was. The schedule goes on: it is the controller's own business.
    """
    places = range(len(retuner.table.regions.names)) if region is None else (region,)
    modes = [retuner.settings.mode_of(i) for i in range(len(retuner.table.regions.names))]
    for i in places:
        modes[i] = mode
    retuner.settings = replace(retuner.settings, region_modes=tuple(modes))
    if mode is not Mode.OFF:
        return None
    undecided = [i for i in places if i in retuner.trials.undecided]
    if not undecided:
        return None
    return retuner.abort(TrialEvent.ORDERED_BACK) if region is None else retuner.rolled_back(undecided[0])


# ---- Pretune: the first model and the first settings of a region, from a step of co that a person commanded.
#
#     record of the step -> model -> is the tuning in force the cause of anything? -> proposal -> proof -> decision
#
# The record is learned as the region's first one, and what follows goes the way of every proposal: the robust rule, the
# guard with its limits per change, the mode of the region, and the trial. Foxboro EXACT's pretune did the same by hand:
# bump, response, settings (TI 039-200, 1995).

WORDS = "pretune, from a commanded step of co"  # how its reasons begin


def pretune(retuner: Retuner, region: int, window: Window) -> Decision:
    """Learn from the record of a commanded step, and decide; the retuner has seen a sample at least.

    region : index of the region in which the step was made. window : its record, from rest; co as applied.

    Raises ValueError: there is no such region.
    """
    outcome = _outcome(retuner, region, window)
    proof, mode = outcome.proof, retuner.settings.mode_of(region)
    if proof is None or proof.gains is None or mode == Mode.OFF:
        return retuner.ordered(region, outcome)
    prediction = prediction_of(proof, retuner.table, region, retuner.scheduled, None, retuner.settings)
    if mode == Mode.ADVISE:
        advised = retuner.ordered(region, outcome)
        return replace(advised, action=Action.ADVISE, gains_after=proof.gains, prediction=prediction)
    return retuner.ordered(region, outcome, proof.gains, prediction)


def _outcome(retuner: Retuner, region: int, window: Window) -> Outcome:
    settings, in_force = retuner.settings, retuner.table.gains_of(region)
    t_s = float(window.t_s[-1])
    try:
        learned = update_region_model(
            retuner.region_models.get(region), window, in_force, settings.tracker, settings.fit, retuner.scheduled
        )
    except np.linalg.LinAlgError as error:  # as in decide.py: one record must not break the supervision
        return Outcome("fit_failed", f"{WORDS}: the fit failed: {error}")
    if learned.region_model is None:
        return Outcome(NOT_KNOWN, f"{WORDS}: {learned.estimate.reason}", learned)
    retuner.region_models[region] = learned.region_model
    retuner.excitation[region] = Excitation(setpoints=1, clear=1)  # from rest: the loop's own doing
    known = KnownProcesses(retuner.table, retuner.region_models, t_s, settings)
    wanted = tuning_of(known, region, in_force)
    if not wanted.ready:
        return Outcome(NOT_KNOWN, f"{WORDS}: {learned.region_model.reason}", learned, diagnosis=wanted.diagnosis)
    if not wanted.diagnosis.retune:
        cause = wanted.diagnosis
        return Outcome(str(cause.cause), f"{WORDS}: {cause.reason}", learned, diagnosis=cause)
    proof = prove(change_request(wanted.tuning, region, retuner.commissioned, known, learned), settings.guard)
    return Outcome(
        proof.code,
        f"{WORDS}: {wanted.diagnosis.reason if proof.accepted else proof.sentence}",
        learned,
        diagnosis=wanted.diagnosis,
        proposal=wanted.tuning,
        basis=Basis.PRETUNE,
        proof=proof,
    )
