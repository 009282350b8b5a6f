"""The judge: good gains keep their promise, bad ones do not, and other upsets undo nothing."""

from dataclasses import replace

import pytest
from rig import BAD, GOOD, MODEL, PROMISE, Rig, responses

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.trial.judge import JudgedResponse, Judgement, TrialFinding, judge
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.prediction import decay_seen, predict
from retuner.adaptive.trial.response_numbers import swing
from retuner.adaptive.trial.rollback import StillAllowed
from retuner.adaptive.trial.supervisor import TrialSupervisor
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains

S = TrialSettings()
STEP, LOAD = {"sp": 5.0}, {"load": 10.0}


def first(rig: Rig, samples: int = 2500, **upset: float) -> Judgement:
    return judge(responses(rig, samples, **upset)[0], PROMISE, rig.gains, S)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("upset", [STEP, LOAD, {"sp": -5.0}, {"load": -10.0}], ids=str)
def test_good_gains_keep_their_promise_under_noise(seed: int, upset: dict[str, float]) -> None:
    found = first(Rig(GOOD, noise=0.025, seed=seed), 300, **upset)
    assert found.finding in {TrialFinding.AS_PROMISED, TrialFinding.BETTER}, found.reason
    numbers = found.numbers.to_dict()
    assert numbers["decay"] < numbers["decay_limit"]


def test_what_is_worse_than_promised_but_better_than_before_is_kept() -> None:
    ringing = PidGains(2.2 * GOOD.kp, 4 * GOOD.ki)
    from_unstable = predict([Plausible(MODEL, 0.0)], PidGains(4 * GOOD.kp, 4 * GOOD.ki), GOOD, 1.0)
    seen = responses(Rig(ringing), 400, load=10.0)[0]
    kept = judge(seen, from_unstable, ringing, S)
    assert kept.finding is not TrialFinding.WORSE
    assert kept.reason.startswith("not as predicted, but no worse than with the previous gains: half-cycle decay ratio")
    assert "; previous gains " in kept.reason
    assert judge(seen, PROMISE, ringing, S).finding is TrialFinding.WORSE


def test_a_decay_beyond_its_limit_by_noise_alone_is_told_so() -> None:
    seen = responses(Rig(GOOD), 400, load=10.0)[0]
    peaks = tuple(Peak(peak.t_s, 0.3 * (-0.35) ** i) for i, peak in enumerate((*seen.response.peaks,) * 3))[:3]
    noisy = replace(seen, response=replace(seen.response, peaks=peaks, band=0.07))
    found = judge(noisy, PROMISE, GOOD, S)
    assert found.finding is TrialFinding.AS_PROMISED
    assert "; at least 0." in found.reason


@pytest.mark.parametrize("seconds", [5, 10, 20, 40])
def test_a_load_that_comes_and_goes_undoes_nothing(seconds: int) -> None:
    rig = Rig(GOOD, noise=0.02)
    found = responses(_Pulsed(rig, seconds), 400)
    assert found
    for seen in found:
        assert judge(seen, PROMISE, GOOD, S).finding is not TrialFinding.WORSE


class _Pulsed:
    """A rig whose load comes after 200 samples and goes after some seconds more."""

    def __init__(self, rig: Rig, seconds: int) -> None:
        self.rig, self.gains, self.left, self.seconds = rig, rig.gains, 200, seconds

    def run(self, samples: int):
        for _ in range(samples):
            self.left -= 1
            self.rig.load = 10.0 if -self.seconds < self.left <= 0 else 0.0
            yield from self.rig.run(1)


def example(**changes: object) -> JudgedResponse:
    seen = responses(Rig(PidGains(2.2 * GOOD.kp, 4 * GOOD.ki)), 400, sp=5.0)[0]
    return replace(seen, response=replace(seen.response, **changes))


def test_what_the_promise_does_not_speak_of_is_inconclusive() -> None:
    assert judge(example(), PROMISE, GOOD, S).finding is TrialFinding.WORSE
    small = (Peak(1.0, 0.3), Peak(2.0, -0.3), Peak(3.0, 0.3))
    for seen, why in (
        (example(peaks=small), "noise bands"),
        (example(peaks=()), "noise bands"),
        (replace(example(), outside="an external oscillation"), "an external"),
    ):
        found = judge(seen, PROMISE, GOOD, S)
        assert found.finding is TrialFinding.INCONCLUSIVE
        assert why in found.reason


@pytest.mark.parametrize("seed", range(5))
def test_a_response_that_was_cut_short_may_speak_against_the_gains_but_not_for_them(seed: int) -> None:
    def cut(gains: PidGains, after: int) -> Judgement:
        rig = Rig(gains, noise=0.025, seed=seed)
        watcher_sees = responses(Stepped(rig, 200, after), 100 + after)
        assert watcher_sees[0].response.ending is Ending.SETPOINT
        return judge(watcher_sees[0], PROMISE, gains, S)

    assert cut(GOOD, 25).finding is TrialFinding.INCONCLUSIVE
    assert cut(BAD["kc /4"], 20).finding is TrialFinding.INCONCLUSIVE
    assert cut(BAD["kc /4"], 80).finding is TrialFinding.WORSE


class Stepped:
    """A rig whose setpoint goes up after some samples and down again after some more."""

    def __init__(self, rig: Rig, up: int, after: int) -> None:
        self.rig, self.gains, self.i, self.up, self.down = rig, rig.gains, 0, up, up + after

    def run(self, samples: int):
        for _ in range(samples):
            self.i += 1
            self.rig.sp = 5.0 if self.up < self.i <= self.down else 0.0
            yield from self.rig.run(1)


def test_a_setpoint_that_moves_on_or_a_start_from_motion_is_inconclusive() -> None:
    seen = example()
    w = seen.window
    ramp = w.sp.copy()
    ramp[-1] += 1.0
    moved = w.pv.copy()
    moved[w.t_s < seen.response.t_start_s] += 0.5
    for window, why in ((Window(w.t_s, ramp, w.pv, w.co), "moving"), (Window(w.t_s, w.sp, moved, w.co), "at rest")):
        found = judge(replace(seen, window=window), PROMISE, GOOD, S)
        assert found.finding is TrialFinding.INCONCLUSIVE
        assert why in found.reason


def test_a_small_rest_of_an_older_upset_is_no_motion() -> None:
    seen = example()
    w = seen.window
    for left, finding in ((0.15, TrialFinding.WORSE), (0.35, TrialFinding.INCONCLUSIVE)):  # of a step of 5, band 0.1
        moved = w.pv - left * (w.t_s < seen.response.t_start_s)
        found = judge(replace(seen, window=Window(w.t_s, w.sp, moved, w.co)), PROMISE, GOOD, S)
        assert found.finding is finding, found.reason


def test_an_output_at_its_limit_says_nothing_of_the_iae() -> None:
    seen = responses(Rig(BAD["kc /4"]), 1500, sp=5.0)[0]
    assert judge(seen, PROMISE, BAD["kc /4"], S).finding is TrialFinding.WORSE
    assert judge(replace(seen, limited_share=0.2), PROMISE, BAD["kc /4"], S).finding is TrialFinding.AS_PROMISED


def test_peaks_within_noise_do_not_speak_against_the_gains() -> None:
    peaks = (Peak(1.0, 0.5), Peak(2.0, -0.17), Peak(3.0, 0.06))
    base = example()
    noisy = replace(
        base,
        response=Response(
            base.response.t_start_s, base.response.t_end_s, peaks, Ending.COMPLETE, sp_changed=False, band=0.1
        ),
    )
    assert judge(noisy, PROMISE, GOOD, S).finding is not TrialFinding.WORSE
    sure = replace(noisy, response=replace(noisy.response, peaks=tuple(Peak(p.t_s, 50 * p.e) for p in peaks)))
    assert judge(sure, PROMISE, GOOD, S).finding is TrialFinding.WORSE


@pytest.mark.parametrize(
    ("before", "peaks", "setpoint", "worse"),
    [(0.71, (20.0, -17.0, 14.0), False, False), (0.05, (20.0, -17.0, 14.0), False, True),
     (0.71, (20.0, -22.0, 25.0), False, True), (0.71, (20.0, -17.0, 14.0), True, True)],
)  # fmt: skip
def test_where_loads_made_the_response_before_swing_only_a_swing_that_grows_is_worse(
    before: float, peaks: tuple[float, ...], *, setpoint: bool, worse: bool
) -> None:
    """A slow loop under real loads had 0.71, where every model has none: 0.82 took back a change that was right."""
    base = example()
    waves = tuple(Peak(float(i), e) for i, e in enumerate(peaks))
    seen = replace(base, response=replace(base.response, peaks=waves, sp_changed=setpoint))
    assert (judge(seen, replace(PROMISE, decay_seen=before), GOOD, S).finding is TrialFinding.WORSE) is worse


def test_what_was_seen_of_the_old_gains_counts_more_than_what_a_model_says_of_them() -> None:
    """A model with five times the gain calls the good gains unstable and promises much of sluggish ones."""
    wrong = Plausible(replace(MODEL, k=5 * MODEL.k), 0.0)
    sluggish = PidGains(GOOD.kp / 5, GOOD.ki / 5)
    lie = predict([wrong], GOOD, sluggish, 1.0)
    seen = responses(Rig(sluggish), 2500, sp=5.0)[0]
    assert judge(seen, lie, sluggish, S).finding is TrialFinding.WORSE
    assert judge(seen, replace(lie, decay_seen=0.05), sluggish, S).finding is TrialFinding.WORSE
    assert judge(seen, replace(lie, decay_seen=1.0), sluggish, S).finding is not TrialFinding.WORSE


def test_decay_seen_is_that_of_a_whole_response_with_a_second_peak() -> None:
    seen = example().response
    assert decay_seen(seen) == pytest.approx(swing([peak.e for peak in seen.peaks], seen.band)[2])
    for other in (None, replace(seen, ending=Ending.SETPOINT), replace(seen, peaks=seen.peaks[:1])):
        assert decay_seen(other) is None


def test_a_response_that_begins_with_a_small_peak_is_judged() -> None:
    """As a process with an inverse response answers a load."""
    base = responses(Rig(BAD["kc /4"], noise=0.025), 2500, load=10.0)[0]
    first, *rest = base.response.peaks
    inverse = (Peak(first.t_s - 5.0, -0.02 * first.e), first, *rest)
    found = judge(replace(base, response=replace(base.response, peaks=inverse)), PROMISE, BAD["kc /4"], S)
    assert found.finding is TrialFinding.WORSE
    assert "IAE" in found.reason
    tiny = tuple(Peak(peak.t_s, 0.01 * peak.e) for peak in inverse)
    small = judge(replace(base, response=replace(base.response, peaks=tiny)), PROMISE, BAD["kc /4"], S)
    assert small.finding is TrialFinding.INCONCLUSIVE


def test_what_the_trial_gains_took_over_in_motion_is_not_judged_by_its_peaks() -> None:
    """The same response speaks against the gains where it is theirs, and says nothing where they found it under way."""
    seen = responses(Rig(PidGains(2.2 * GOOD.kp, 4 * GOOD.ki), noise=0.025), 400, **STEP)[0]
    taken = replace(seen, response=replace(seen.response, taken_over=True))
    assert judge(seen, PROMISE, GOOD, S).finding is TrialFinding.WORSE
    found = judge(taken, PROMISE, GOOD, S)
    assert found.finding is TrialFinding.INCONCLUSIVE
    assert found.reason == "the response itself is not judged: it began under other gains"


def test_where_all_samples_hold_a_set_for_robust_loads_explain_what_speaks_against_it() -> None:
    """What swings, and what is slow where the change was no less integral action."""
    strong = PidGains(2.2 * GOOD.kp, 4 * GOOD.ki)
    for gains, words in ((strong, "decay ratio"), (BAD["kc /4"], "IAE")):
        seen = responses(Rig(gains, noise=0.025), 400, sp=5.0)[0]
        assert judge(seen, PROMISE, gains, S).finding is TrialFinding.WORSE
        found = judge(replace(seen, robust=True), PROMISE, gains, S, more=words == "IAE")
        assert found.finding is TrialFinding.INCONCLUSIVE
        assert "a wandering load explains this response equally well" in found.reason
        assert words in found.reason
    assert judge(replace(seen, robust=True), PROMISE, gains, S).finding is TrialFinding.WORSE


@pytest.mark.parametrize(("robust", "stays"), [(True, True), (False, False)])
def test_a_set_that_is_robust_by_all_samples_outlives_models_where_no_response_answers(*, robust, stays):
    weak, table = BAD["kc /4"], dict[int, PidGains]()
    fiction = StillAllowed((replace(MODEL, k=3.0 * MODEL.k).linear(),))
    trials = TrialSupervisor(S, 1.0, table.__setitem__, lambda _: fiction)
    trials.begin(0, weak, GOOD, PROMISE, 0.0)
    trials.written(0, GOOD, 1.0)
    silent = judge(responses(Rig(GOOD, noise=0.025), 400, load=10.0)[0], replace(PROMISE, wander=100.0), GOOD, S)
    assert silent.finding is TrialFinding.INCONCLUSIVE
    for i in range(S.inconclusive):
        trials.silent(0, silent, 10.0 + i, robust=robust)
    assert trials.phase(0) is (TrialPhase.IDLE if stays else TrialPhase.RESTORING)
    assert table == ({} if stays else {0: weak})
