"""On line, a controller that acts the wrong way is named so, not by what comes of it: a pv far out of its range."""

from dataclasses import replace

import pytest
from loop_bench import Bench, scaled, table

from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings


def decided(sign: int) -> list[Decision]:
    """After a setpoint step under gains for a process of gain +1, on one of gain `sign`."""
    settings = replace(RetunerSettings(1.0, 10.0, Mode.AUTO), pv_range=(-2.0, 2.0))
    bench = Bench(Retuner(table(scaled(0.3, 0.3)), settings), sign)
    return bench.run(400) + bench.run(300, 1.0) + bench.run(300, 0.0)


@pytest.fixture(scope="module")
def wrong() -> list[Decision]:
    return decided(-1)


def test_it_is_named_with_what_to_do(wrong: list[Decision]) -> None:
    assert wrong[0].code == "wrong_way"
    assert "take the loop to manual" in wrong[0].reason


def test_nothing_is_written_and_nothing_learned(wrong: list[Decision]) -> None:
    assert {(d.action, d.records) for d in wrong} == {(Action.NONE, 0)}


def test_a_loop_that_acts_the_right_way_is_not_called_so() -> None:
    assert "wrong_way" not in {d.code for d in decided(1)}


def test_it_is_named_as_well_where_the_loop_never_was_at_rest() -> None:
    bench = Bench(Retuner(table(scaled(0.3, 0.3)), RetunerSettings(1.0, 10.0, Mode.AUTO)), -1)
    assert [d.code for d in bench.run(1100, 1.0)] == ["wrong_way"]
