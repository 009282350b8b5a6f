"""The page says on which process its curves rest where this record does not bear it out."""

from typing import Any

import pytest
from decision_documents import COMMIT, MODEL, changed, view

from retuner.decision_page.decision_document import article
from retuner.decision_page.decision_sentences import footing, robustness

KNOWN = {"model": {**MODEL, "k": 1.4}, "std": {"k": 0.42}}
FOUND: Any = COMMIT["estimate"]
VAGUE = {**FOUND, "identifiable": False, "reason": "k is known to 80 % only"}
RESTS = "Curves, margins and predictions use "
BEFORE = f"{RESTS}the model before this record (k 1.4 +- 0.42 (30.0%) degC/%, "
APART = " The proposal does not use it."


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "begins", "ends"),
    [
        (
            {"surprise": "odd"},
            BEFORE,
            "This record contradicts it: on its own it gives k 2 tau1 240 s tau2 9 s theta 26 s.",
        ),
        (
            {"surprise": "odd", "estimate": VAGUE, "basis": "pattern"},
            BEFORE,
            f"theta 26 s (not identified either: k is known to 80 % only).{APART}",
        ),
        (
            {"surprise": "silent", "estimate": VAGUE, "basis": "pattern"},
            BEFORE,
            f", which does not identify the process.{APART}",
        ),
        (
            {"surprise": "agrees", "estimate": VAGUE, "basis": "slow_oscillation"},
            f"{RESTS}a model that is not accurate enough yet (k 1.4 +- 0.42 (30.0%) degC/%, ",
            f": k is known to 80 % only.{APART}",
        ),
    ],
)
def test_curves_that_the_record_does_not_bear_out_say_so(parts: dict[str, object], begins: str, ends: str) -> None:
    shown = view(changed(known=KNOWN, **parts), drawn=False)
    told = footing(shown)
    assert told.startswith(begins)
    assert told.endswith(ends)
    assert told in article(shown)


@pytest.mark.parametrize("surprise", ["first", "agrees", "changed", "opened", None])
def test_curves_that_the_record_bears_out_need_no_word(surprise: str | None) -> None:
    shown = view(changed(known=KNOWN, surprise=surprise), drawn=False)
    assert footing(shown) == ""
    assert "contradicts" not in robustness(shown)


def test_without_a_process_there_is_nothing_to_rest_on() -> None:
    assert footing(view(changed(estimate=None, verdict=None, surprise="odd"), drawn=False)) == ""


def test_ms_of_a_contradicted_process_is_not_told_as_if_it_held() -> None:
    shown = view(changed(known=KNOWN, surprise="odd"), drawn=False)
    assert robustness(shown).startswith("On the identified process, which this record contradicts: Ms 2.88 before")
