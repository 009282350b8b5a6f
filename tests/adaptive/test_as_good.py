"""A loop that does not swing is not made slower while a model that is as good holds it for robust."""

from dataclasses import replace

import pytest
from loop_bench import Bench, scaled, table

from retuner.adaptive.supervision.decision import Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.settings import RetunerSettings

USUAL = RetunerSettings(1.0, 10.0, Mode.AUTO)


def decided(settings: RetunerSettings, share: float) -> list[Decision]:
    """Of a loop with so many times the rule's gain, over several upsets."""
    return Bench(Retuner(table(scaled(share, share)), settings), seed=2).exercise()


@pytest.fixture(scope="module")
def bold() -> list[Decision]:
    """A little over its limit by the models, and slower by what the rule gives."""
    return decided(USUAL, 1.1)


def test_a_loop_in_order_is_left_alone(bold: list[Decision]) -> None:
    assert "commit" not in {str(d.action) for d in bold}
    assert [d.reason for d in bold if d.code == "as_good"]


def test_without_that_it_would_be_made_slower() -> None:
    assert "commit" in {str(d.action) for d in decided(replace(USUAL, worth_iae=2.0, behaving_records=1), 1.1)}


def test_a_loop_that_is_over_its_limit_on_every_model_is_made_slower() -> None:
    assert "commit" in {str(d.action) for d in decided(USUAL, 2.0)}
