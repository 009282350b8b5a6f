"""A load that wanders may explain what speaks against a set: it is asked, and refused where it explains less."""

from dataclasses import replace

import numpy as np
import pytest
from rig import BAD, GOOD, MODEL, PROMISE, Rig, responses
from test_posterior_check import DT_S, STRONG, TRUE

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.trial.judge import TrialFinding, judge
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.posterior_check import check_posterior
from retuner.adaptive.trial.random_walk import beside_a_walk, deviance, made_for, stretches_of
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, StillAllowed
from retuner.adaptive.trial.supervisor import TrialSupervisor
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains

S = TrialSettings()
WALK = 0.15
"""Of a load per sample: pv wanders by about ten times the noise."""


def walked(k: float, seed: int, samples: int = 500) -> list[LoopSample]:
    """A loop under the right gains of MODEL, its process k times as strong, a step in the middle, a load that walks."""
    rig, rng = Rig(GOOD, k=k, noise=0.02, seed=seed), np.random.default_rng(seed)
    seen: list[LoopSample] = []
    for i in range(samples):
        rig.load += WALK * float(rng.standard_normal())
        rig.sp = 2.0 * (i >= samples // 2)
        seen += rig.run(1)
    return seen


def explained(samples: list[LoopSample], models: list[ProcessModel], gains: PidGains = GOOD) -> bool:
    found = beside_a_walk(samples, models, gains, DT_S, 0.0, S.harmless_ms, S.level)
    return found is not None and not found.processes


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_model_that_took_a_walk_for_the_process_says_nothing_against_a_right_set(seed: int) -> None:
    fiction = [replace(MODEL, k=3.0 * MODEL.k), replace(MODEL, k=3.5 * MODEL.k)]
    assert all(sensitivity_peak(model.linear(), GOOD) > S.harmless_ms for model in fiction)
    assert explained(walked(1.0, seed), fiction)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_no_walk_clears_a_set_that_is_too_strong(seed: int) -> None:
    truth = replace(MODEL, k=2.2 * MODEL.k)
    assert sensitivity_peak(truth.seen_by_controller(DT_S).linear(), GOOD) > S.harmless_ms
    assert not explained(walked(2.2, seed), [truth])


def test_the_samples_are_likeliest_on_the_process_that_made_them() -> None:
    seen = stretches_of(walked(1.0, 4, 900), MODEL.theta_s)
    assert seen is not None
    assert seen.pv.shape == seen.co.shape
    at = {k: deviance(replace(MODEL, k=k).linear(), seen) for k in (0.5, 1.0, 2.0)}
    late = {x: deviance(replace(MODEL, theta_s=x * MODEL.theta_s).linear(), seen) for x in (0.5, 1.0, 1.8)}
    assert min(at, key=at.__getitem__) == 1.0
    assert min(late, key=late.__getitem__) == 1.0
    assert deviance(replace(MODEL, theta_s=100 * MODEL.theta_s).linear(), seen) == float("inf")


def test_what_was_recorded_before_a_gap_does_not_count() -> None:
    seen = walked(1.0, 1, 200)
    later = [sample._replace(t_s=sample.t_s + 1e4) for sample in seen[100:]]
    parts = stretches_of([*seen[:100], *later], MODEL.theta_s), stretches_of(later, MODEL.theta_s)
    assert parts[0] is not None
    assert parts[1] is not None
    assert np.array_equal(parts[0].pv, parts[1].pv)
    assert stretches_of(seen[:20], MODEL.theta_s) is None
    assert not explained(seen[:20], [MODEL])


def test_processes_are_those_for_which_the_rule_gives_the_set() -> None:
    assert made_for(PidGains(1.0, 0.0)) == []
    for model in made_for(GOOD):
        assert model.type is ProcessType.FOPDT
        assert sensitivity_peak(model.linear(), GOOD) == pytest.approx(1.59, abs=0.02)
    assert explained(walked(1.0, 1), []), "without a model that speaks against the set"


def test_the_models_word_does_not_count_where_the_walk_explains_it() -> None:
    seen = responses(Rig(STRONG, noise=0.025), 400, load=10.0)[0]
    seen = replace(seen, posterior=check_posterior(TRUE, GOOD, STRONG, DT_S))
    assert judge(seen, PROMISE, STRONG, S).finding is TrialFinding.WORSE
    assert judge(replace(seen, beside_walk=NOTHING_KNOWN), PROMISE, STRONG, S).finding is not TrialFinding.WORSE
    swings = responses(Rig(STRONG, noise=0.025), 400, sp=5.0)[0]
    assert judge(swings, PROMISE, GOOD, S).finding is TrialFinding.WORSE
    found = judge(replace(swings, beside_walk=NOTHING_KNOWN), PROMISE, GOOD, S)
    assert found.finding is TrialFinding.INCONCLUSIVE
    assert "a wandering load explains this response equally well" in found.reason


@pytest.mark.slow
def test_the_processes_for_which_a_set_was_made_are_no_witnesses_for_it() -> None:
    found = beside_a_walk(walked(2.2, 1), [], GOOD, DT_S, 0.0, S.harmless_ms, S.level)
    assert found is not None
    assert min(found.ms(GOOD)) > S.harmless_ms
    assert beside_a_walk(walked(2.2, 1)[:20], [], GOOD, DT_S, 0.0, S.harmless_ms, S.level) is None


FICTION = StillAllowed((replace(MODEL, k=3.0 * MODEL.k).linear(),))


@pytest.mark.parametrize(
    ("known", "walked", "stays"),
    [
        (FICTION, NOTHING_KNOWN, True),  # what the models say against it, the walk explains
        (FICTION, None, False),
        (NOTHING_KNOWN, None, True),
        (NOTHING_KNOWN, FICTION, False),  # where there is no model, the walk leaves one
        (StillAllowed((MODEL.linear(),)), FICTION, True),  # what the records say counts more than the walk
    ],
)
def test_what_a_walk_leaves_decides_a_trial_without_an_answer(
    known: StillAllowed, walked: StillAllowed | None, *, stays: bool
) -> None:
    weak, table = BAD["kc /4"], dict[int, PidGains]()
    trials = TrialSupervisor(S, DT_S, table.__setitem__, lambda _: known)
    trials.begin(0, weak, GOOD, PROMISE, 0.0)
    trials.written(0, GOOD, 1.0)
    silent = judge(responses(Rig(GOOD, noise=0.025), 400, load=10.0)[0], replace(PROMISE, wander=100.0), GOOD, S)
    assert silent.finding is TrialFinding.INCONCLUSIVE
    for i in range(S.inconclusive):
        trials.silent(0, silent, 10.0 + i, beside_walk=walked)
    assert trials.phase(0) is (TrialPhase.IDLE if stays else TrialPhase.RESTORING)
    assert table == ({} if stays else {0: weak})
