"""What safer means: smaller Ms on the process and at worst, larger on no model."""

import math
from dataclasses import replace

from effort import examples
from guard_cases import GAINS, MODEL, times
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.adaptive.guard.proof import MsOnModels
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess

PLAIN = MODEL.linear()


def test_the_same_is_not_safer() -> None:
    assert not MsOnModels([PLAIN]).safer(GAINS, GAINS, GAINS)


def test_a_model_that_cannot_tell_does_not_hold_it_up() -> None:
    """Ms is 1 before and after on a process that hardly answers; the worst of all models is another one."""
    frozen = LinearProcess(1e-9, (1.0,))
    assert MsOnModels([PLAIN, frozen]).safer(times(1.2, 1.2), GAINS, GAINS)


def test_unstable_before_and_after_less_of_everything_is_safer() -> None:
    wild, less = times(40.0, 40.0), times(20.0, 20.0)
    far = times(30.0, 30.0)
    loops = MsOnModels([PLAIN])
    assert math.isinf(loops.nominal(less))
    assert loops.safer(wild, less, far)
    assert not loops.safer(less, wild, far)
    shifted = times(20.0, 35.0)  # tau_I shortens
    assert not loops.safer(wild, shifted, far)
    assert loops.safer(wild, shifted, GAINS)  # on the way to a goal that is stable


FACTOR = st.floats(0.05, 20)


@settings(max_examples=examples(150))
@given(a=st.tuples(FACTOR, FACTOR), b=st.tuples(FACTOR, FACTOR), k=st.floats(0.3, 3), theta=st.floats(0.3, 3))
def test_safer_means_what_it_says(a: tuple[float, float], b: tuple[float, float], k: float, theta: float) -> None:
    models = [PLAIN, replace(MODEL, k=2.0 * k, theta_s=5.0 * theta).linear()]
    old, new = times(*a), times(*b)
    loops = MsOnModels(models)
    if not loops.safer(old, new, GAINS):
        return
    before, after = ([sensitivity_peak(m, g) for m in models] for g in (old, new))
    assert all(now <= then for now, then in zip(after, before, strict=True))
    if not any(map(math.isinf, after)):
        assert after[0] < before[0]
        assert max(after) < max(before)
    assert not loops.safer(new, old, GAINS) or any(map(math.isinf, after))


@settings(max_examples=examples(80))
@given(factor=st.floats(1.5, 15), share=st.floats(0.05, 1))
def test_every_step_from_a_hot_loop_towards_its_settings_is_safer(factor: float, share: float) -> None:
    old = times(factor, factor)
    new = times(factor ** (1 - share), factor ** (1 - share))
    assert MsOnModels([PLAIN]).safer(old, new, GAINS)
