"""What the report's first sentences say: the result, and nothing that is not so."""

from dataclasses import replace

import numpy as np
import pytest

from retuner import GainTable, LinearProcess, Regions
from retuner.report.console import scores_table
from retuner.report.report import ReportData, as_commissioned, marks_of, render
from retuner.report.scores import RegionScore, Twin, region_scores, twin_steps
from retuner.schedule.gains import PidGains, from_form

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
            "1 change was written to the controller. Ms of the final gains on the simulated "
            "process is at most 1.50. The integrated error is 50% smaller than with fixed gains.",
        ),
        (
            score(float("inf"), 100.0, 100.0),
            "0 changes were written to the controller. Ms of the final gains on the simulated process is not finite: "
            "the loop is UNSTABLE. The integrated error is the same as with fixed gains.",
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
    assert (
        "0 responses were recognised in 1 h. 1 change was written to the controller. 1 change was rolled back" in text
    )
    assert '<a href="#decision-2">2</a>' in text


def test_a_set_that_stays_at_the_end_is_not_told_of_as_taken_back() -> None:
    gains: dict[str, object] = {"kp": 2.0, "ki": 0.5, "kd": 0.0}
    row: dict[str, object] = {"number": 2, "t_s": 1800.0, "region": "all", "action": "restore", "code": "kept_stopped"}
    row |= {"reason": "the gains on trial stay", "gains_before": gains, "gains_after": gains}
    told = ReportData("loop", "u", TABLE, TABLE, [score(1.5, 1.0, None, 1)], [row], RUN, None, [900.0])
    text = render(told)
    assert "rolled back" not in text
    assert "undone" not in text
    assert "restored" not in text
    assert "The trial settings stay" in text
    assert "kept: Kc 2 tau_I 4 s" in text
    assert not any(mark.rolled_back for mark in marks_of(told, [row]))


def test_ms_over_the_limit_is_red_with_the_reason() -> None:
    assert 'class="bad">2.37' not in page(score(1.7, 1.0, None))
    text = page(score(2.37, 1.0, None))
    assert '<b class="bad">2.37, over 1.75</b>' in text
    assert "no response of this region was recognised" in text
    assert "is at most 2.37, over the limit of 1.75 (see the red cells)." in text
    refused: dict[str, object] = {
        "number": 7,
        "t_s": 900.0,
        "region": "all",
        "action": "none",
        "reason": "the model is not accurate enough",
        "verdict": {"ms": {"before": 1.62}},
    }
    told = ReportData("loop", "u", TABLE, TABLE, [score(2.37, 1.0, None)], [refused], RUN, None, [], ms_limit=1.6)
    text = render(told)
    assert "over 1.6<" in text
    assert "nothing was changed; the newest decision 7: the model is not accurate enough" in text
    assert "on the identified process it was 1.62" in text


def test_marks_carry_the_numbers_of_their_decisions() -> None:
    write: dict[str, object] = {"number": 4, "t_s": 900.0, "region": "all", "action": "commit"}
    undo: dict[str, object] = {"number": 5, "t_s": 1800.0, "region": "all", "action": "restore"}
    advice: dict[str, object] = {"number": 6, "t_s": 1900.0, "region": "all", "action": "advise"}
    data = ReportData("loop", "u", TABLE, TABLE, [], [], RUN, None, [901.0])
    found = marks_of(data, [write, undo, advice])
    assert [(mark.t_s, mark.number, mark.rolled_back) for mark in found] == [(900.0, 4, False), (1800.0, 5, True)]
    assert [mark.number for mark in marks_of(data, [])] == [0]


def test_a_step_is_compared_with_the_commissioned_gains_or_that_is_said() -> None:
    t = np.arange(0.0, 400.0)
    sp = np.where((t >= 100) & (t < 200) | (t >= 300), 1.0, 0.0)
    run = {name: np.zeros(400) for name in NAMES} | {"t": t, "sp": sp, "kp": np.full(400, 2.0), "ki": np.full(400, 0.1)}
    twin = Twin(0, (100, 200), (300, 400), "setpoint 0 to 1")
    told = ReportData("loop", "u", TABLE, TABLE, [], [], run, None, [])
    assert as_commissioned(told, twin)
    assert not as_commissioned(replace(told, run=run | {"kp": np.where(t < 150, 2.0, 2.5)}), twin)
    assert "There was no run with fixed gains" in render(replace(told, events=[]))
    assert "There was no run with fixed gains" not in render(replace(told, fixed=run))
    assert "The same step, before and after" in render(replace(told, scores=[score(1.5, 1.0, None, changes=1)]))
    assert "The same step, before and after" not in render(replace(told, scores=[score(1.5, 1.0, None)]))


def test_a_report_fits_a_narrow_screen_and_paper() -> None:
    text = page(score(1.5, 1.0, None))
    assert '<meta name="viewport" content="width=device-width' in text
    assert "@media (max-width:620px)" in text
    assert "@media print" in text


def test_the_screen_marks_ms_over_the_limit() -> None:
    marked = scores_table([score(2.37, 1.0, None)], "u")
    assert "!! over the limit of 1.75" in str(marked.title)
    assert "[bold red]2.37 !![/]" in list(marked.columns[5].cells)
    assert "!!" not in str(scores_table([score(1.7, 1.0, None)], "u").title)


# The scores of a run: what they are measured against.


def table(gains: PidGains) -> GainTable:
    return GainTable("loop", Regions("sp", "u", ("all",), 0.0, (), 100.0, 0.0, 0.0), (gains,))


def test_ms_counts_the_filter_of_the_derivative() -> None:
    gains = from_form("series", 1.0, 50.0, 60.0)  # without a filter |L| never falls below kd / lag = 1.2: unstable
    columns = {name: np.array([0.0, 1.0]) for name in ("t", "sp", "pv", "region")}
    columns["region"] = np.zeros(2)

    def ms(tau_f_s: float) -> float | None:
        scores = region_scores(
            table(gains), table(gains), [], columns, None, lambda _: LinearProcess(1.0, (50.0,), (), 1.0), 1.0, tau_f_s
        )
        return scores[0].ms_after

    assert ms(0.0) == float("inf")
    assert ms(20.0) == pytest.approx(1.1, abs=0.3)


def test_a_run_that_was_stopped_is_compared_with_as_much_of_the_one_with_fixed_gains() -> None:
    """An error of 1,049 in half the time stood beside 2,282 in all of it."""
    gains, n = from_form("series", 1.0, 50.0, 0.0), 100
    fixed = {name: np.zeros(n) for name in ("pv", "region")} | {"t": np.arange(float(n)), "sp": np.ones(n)}
    run = {name: x[:40] for name, x in fixed.items()}
    score = region_scores(table(gains), table(gains), [], run, fixed, None, 1.0)[0]
    assert score.iae_fixed == score.iae == 39.0


def test_a_load_under_which_the_region_was_only_left_is_no_operating_point() -> None:
    """Four samples until the boundary is crossed, in less than the dead time: nothing comes back in them."""
    n, gains = 100, from_form("series", 1.0, 50.0, 0.0)
    columns = {name: np.zeros(n) for name in ("sp", "pv", "region")} | {"t": np.arange(float(n))}

    def ms(stayed: int) -> float | None:
        loads = np.where(np.arange(n) >= n - stayed, 1.0, 0.0)

        def true(_: float, load: float = 0.0) -> LinearProcess:
            return LinearProcess(20.0 if load else 1.0, (50.0,), (), 8.0)

        return region_scores(table(gains), table(gains), [], columns, None, true, 1.0, 0.0, loads)[0].ms_after

    assert ms(4) == ms(0)
    assert ms(4) == pytest.approx(1.2, abs=0.2)
    assert ms(20) == float("inf")


@pytest.mark.parametrize("left", [1, 9, 10])
def test_a_step_at_the_very_end_is_no_twin(left: int) -> None:
    sp = np.array([20.0] * 50 + [30.0] * 50 + [20.0] * 50 + [30.0] * 50 + [20.0] * 50 + [30.0] * left)
    columns = {"t": np.arange(len(sp), dtype=float), "sp": sp, "region": np.zeros(len(sp))}
    last = (150, 200) if left < 10 else (250, 260)
    assert twin_steps(columns, []) == [Twin(0, (50, 100), last, "setpoint 20 to 30")]
