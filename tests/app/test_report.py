"""What the report's first sentences say: the result, and nothing that is not so."""

import numpy as np
import pytest

from retuner.report.console import scores_table
from retuner.report.report import ReportData, render
from retuner.report.scores import RegionScore
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

GAINS = PidGains(2.0, 0.1)
TABLE = GainTable("loop", Regions("sp", "u", ("all",), 0.0, (), 100.0, 0.0, 0.0), (GAINS,))
NAMES = ("t", "sp", "pv", "co", "region", "kp", "ki", "kd")
RUN = {name: np.linspace(0.0, 3600.0, 5) if name == "t" else np.zeros(5) for name in NAMES}


def score(ms: float | None, iae: float, fixed: float | None, changes: int = 0) -> RegionScore:
    return RegionScore("all", GAINS, GAINS, changes, ms, ms, iae, fixed)


def page(found: RegionScore, *, stopped: bool = False) -> str:
    return render(ReportData("loop", "u", TABLE, TABLE, [found], [], RUN, None, [], stopped=stopped))


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (
            score(1.5, 50.0, 100.0, 1),
            "1 change was written to the controller. Ms of the final gains on the true "
            "process is at most 1.50. The integrated error is 50% smaller than with fixed gains.",
        ),
        (
            score(float("inf"), 100.0, 100.0),
            "0 changes were written to the controller. Ms of the final gains on the "
            "true process is not finite: the loop is UNSTABLE. The integrated error is the same as with fixed gains.",
        ),
        (
            score(None, 120.0, 100.0, 2),
            "2 changes were written to the controller. The integrated error is 20% LARGER than with fixed gains.",
        ),
        (score(None, 120.0, None), "0 changes were written to the controller.</p>"),
    ],
)
def test_the_lead_says_the_result(found: RegionScore, said: str) -> None:
    text = page(found)
    assert said in text
    assert "stopped" not in text


def test_a_run_that_was_stopped_says_so_first() -> None:
    assert "The run was stopped before its end. 0 responses were recognised in 1 h." in page(
        score(1.5, 1.0, None), stopped=True
    )


def test_an_equal_error_is_neither_good_nor_bad() -> None:
    assert '<span class="">100</span>' in page(score(1.5, 100.0, 100.0))


def test_the_table_speaks_of_a_comparison_only_where_there_is_one() -> None:
    assert "fixed gains" in str(scores_table([score(1.5, 1.0, 2.0)], "u").title)
    assert "fixed gains" not in str(scores_table([score(1.5, 1.0, None)], "u").title)


def test_changes_that_were_taken_back_are_counted_and_not_as_responses() -> None:
    undo: dict[str, object] = {"number": 2, "t_s": 1800.0, "region": "all", "action": "restore", "reason": "worse"}
    told = ReportData("loop", "u", TABLE, TABLE, [score(1.5, 1.0, None, 1)], [undo], RUN, None, [900.0])
    text = render(told)
    assert "0 responses were recognised in 1 h. 1 change was written to the controller. 1 change was taken back" in text
    assert '<a href="#decision-2">2</a>' in text
