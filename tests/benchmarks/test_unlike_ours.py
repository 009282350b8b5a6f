"""The streaming harness: its truth against what is known in closed form, and one story from end to end."""

import math
from itertools import pairwise

import pytest
from unlike_ours.live import PlantLive
from unlike_ours.process import Linear, exothermic, tank
from unlike_ours.run import oddities, promised, run, staying, table, tasks
from unlike_ours.story import EVENTS, draw
from unlike_ours.truth import Truth, Tuned


@pytest.fixture(scope="module")
def lag() -> Truth:
    return Truth(Linear((2.0,), (1.0, 10.0), 2.0), 0.0)


def test_pure_integral_action_on_a_dead_time_is_unstable_from_half_pi_on(lag: Truth) -> None:
    """Integrator and dead time: the limit is k theta = pi/2."""
    cancelled = [Tuned(share * math.pi / 2 * 10 / (2 * 2), share * math.pi / 2 / (2 * 2)) for share in (0.98, 1.02)]
    assert math.isfinite(lag.ms(cancelled[0]))
    assert math.isinf(lag.ms(cancelled[1]))


def test_simc_on_a_lag_has_the_ms_that_is_known_and_the_reference_is_near_it(lag: Truth) -> None:
    """Skogestad 2003: tau_c = theta, tau1 cancelled, Ms 1.59."""
    simc = Tuned(10 / (2 * 4), 1 / (2 * 4))
    assert lag.ms(simc) == pytest.approx(1.59, abs=0.01)
    assert 0.8 < lag.of(simc).j < 1.1
    assert lag.ms_best == pytest.approx(1.55, abs=0.06)
    assert not lag.in_spec(Tuned(simc.kp / 3, simc.ki / 3))


@pytest.mark.parametrize(("plant", "pv"), [(tank(10.0), 30.0), (exothermic(10.0), 325.0)])
def test_a_plant_by_its_equations_stays_where_it_rests_and_its_local_gain_is_that_of_two_rests(plant, pv):
    live = plant.live(pv, 0.5)
    assert live.move(plant.rest(pv)) == pytest.approx(pv, rel=1e-9)
    local = plant.local(pv)
    k = 0.02 / (plant.rest(pv + 0.01) - plant.rest(pv - 0.01))
    assert local.num[0] / local.den[0] == pytest.approx(k, rel=1e-3)


def test_a_story_has_its_disturbances_and_its_plant_rests_at_the_start() -> None:
    story = draw("forms", 1, 0)
    assert len(story.events) == EVENTS
    assert all(earlier.t <= later.t for earlier, later in pairwise(story.events))
    plant = PlantLive(story)
    assert [plant.move(story.co_start, 0.0, story.dt) for _ in range(50)] == pytest.approx([story.start_pv] * 50)


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_loop_that_begins_wrong_ends_in_spec_and_is_counted() -> None:
    row = run(tasks(1, 1, ("forms",))[0])
    assert (row["error"], row["odd"]) == ("", [])
    assert row["spec"][-1]
    assert staying(row, 6)
    assert len(table([row])) >= 3
    assert not any(change["unstable"] or change["ms_worse"] for change in row["told"])


def test_what_a_change_promises_and_sentences_that_contradict_themselves_are_seen() -> None:
    assert promised("Kc 1 -> Kc 2, Ms 1.20 -> 1.47 (worst case 1.50)") == 1.47
    assert promised("no change") is None
    assert oddities("the largest allowed distance: requested 2.1, limit 3.2")
    assert not oddities("the largest allowed distance: requested 3.3, limit 3.2")
