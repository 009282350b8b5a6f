"""Plants that schedules are judged on: against their own linearisation, exact results, and what is counted of them."""

import numpy as np
import pytest
from cases.plant import HeldPlant
from online.runner import collect
from schedules import measure, physics, records, rivals
from schedules.tables import table
from schedules.truth import Truth, counts


def small_step(subject, place, size, n):
    """pv after a small step of co, a unit of it."""
    live = subject.live(place)
    return np.array([live.move(subject.rest(place) + size, place) - subject.sp_at(place) for _ in range(n)]) / size


@pytest.mark.parametrize("name", sorted(physics.MAKERS))
def test_small_steps_of_a_plant_show_its_linearisation(name):
    subject = physics.MAKERS[name]()
    for place in subject.places(2):
        local = subject.local(place)
        held = HeldPlant(local, subject.dt_s)
        exact = np.array([held.move(1.0) for _ in range(200)])
        found = small_step(subject, place, 1e-3 * subject.span / abs(local.k), 200)
        assert found == pytest.approx(exact, abs=0.03 * np.max(np.abs(exact)))


def test_a_place_from_outside_changes_the_process_and_not_its_rest():
    subject = records.draw(np.random.default_rng(4), "smooth", 4.0, by="flow")
    live = subject.live(10.0)
    assert {live.move(0.0, place) for place in (10.0, 40.0, 90.0)} == {subject.sp0}
    assert small_step(subject, 80.0, 1e-3, 400)[-1] == pytest.approx(subject.local(80.0).k, rel=0.02)


def test_one_set_suffices_for_a_constant_process_and_not_for_one_that_changes_by_ten():
    constant = Truth(records.draw(np.random.default_rng(1), "constant", 1.0), 3)
    assert constant.fewest == (1, 1)
    changing = Truth(records.draw(np.random.default_rng(5), "kink", 10.0), 5)
    assert min(changing.fewest) > 1
    assert counts(changing, changing.perfect())["spec"] == 5
    assert counts(changing, rivals.fixed(changing))["spec"] < 5


@pytest.mark.uncounted
@pytest.mark.nightly
def test_a_case_is_walked_counted_and_not_run_twice(tmp_path):
    tasks = measure.tasks(1, 1, ("constant",), ("fixed",), visits=1, places=3, walk=2, rivals=False)
    file, ran = tmp_path / "rows.jsonl", []

    def work(task):
        ran.append(task)
        return measure.measure(task)

    for _ in range(2):
        rows, whole = collect(work, tasks, 1, file, None, more=True)
        assert whole
    assert len(ran) == 1
    assert rows[0]["who"]["perfect"]["iae"] == 1.0
    assert rows[0]["who"]["before"]["iae"] > 1.0
    assert table(rows)[0] == "constant x1, fixed: 1 cases"
