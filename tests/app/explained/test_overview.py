"""The overview of the regions: the newest that is known of each, and a grid where there are two variables."""

import pytest
from decision_documents import BORROWED, COMMIT, REFUSED, RESTORED, plain

from retuner import Axis, GainTable, PidGains, Regions
from retuner.report.report import overview, regions_now
from retuner.templates import rendered

ROW = Regions("sp", "degC", ("low", "middle"), 0.0, (50.0,), 100.0, 1.0, 0.0)


def test_each_region_tells_its_newest_state() -> None:
    later = {**BORROWED, "number": 9, "records": 4}
    low, middle = regions_now(("low", "middle"), [COMMIT, {**REFUSED, "diagnosis": None}, later, RESTORED])
    assert (low.seen, low.process, low.trial) == (0, "", "")
    assert (middle.seen, middle.changes, middle.rolled_back, middle.borrowed) == (4, 2, 1, True)
    assert middle.process.endswith("(4 records)")
    assert middle.cause == "aggressive"
    assert middle.trial == "rolled back"
    (settled,) = regions_now(("middle",), [COMMIT, {**COMMIT, "action": "none"}])
    assert settled.cause == "settled: nothing better is proved"
    assert regions_now(("middle",), [COMMIT])[0].cause == "changed, not judged yet"


@pytest.mark.parametrize(
    ("last", "state"),
    [
        ({"code": "kept_stopped", "trial": "on trial"}, "trial gains kept at the end of the session"),
        ({"code": "kept_manual", "trial": "on trial"}, "trial gains kept"),
        ({"code": "undo_stopped", "action": "restore"}, "rolled back at the end of the session"),
        ({"action": "commit", "trial": "writing"}, "on trial"),
        ({"trial": "cooling down"}, "cooling down"),
    ],
)
def test_a_trial_that_is_over_is_not_told_as_going_on(last: dict[str, object], state: str) -> None:
    (now,) = regions_now(("middle",), [COMMIT, {"region": "middle", "action": "none", **last}])
    assert now.trial == state


def test_the_overview_says_what_is_known_borrowed_and_advised() -> None:
    table = GainTable("oven", ROW, (PidGains(2.0, 0.1), PidGains(1.0, 0.05)))
    text = rendered(
        "regions.html.jinja", regions=overview(table, [COMMIT, BORROWED, RESTORED], ["two processes <in> middle"])
    )
    for told in ("nothing yet", "1 rolled back", "two processes &lt;in&gt; middle", "mode auto"):
        assert told in text
    assert "Settings over both variables" not in text


def test_a_map_of_two_variables_is_a_grid() -> None:
    regions = Regions.along(
        ("a", "b", "c", "d"), Axis("sp", "degC", 0.0, (50.0,), 100.0), Axis("co", "%", 0.0, (40.0,), 100.0)
    )
    table = GainTable("oven", regions, tuple(PidGains(kp, 0.1) for kp in (1.0, 2.0, 3.0, 4.0)))
    text = plain(rendered("regions.html.jinja", regions=overview(table, [])))
    assert '<tr class=""><td>50 to 100 degC</td><td>c: Kc 3 tau_I 30 s</td><td>d: Kc 4 tau_I 40 s</td></tr>' in text
    assert "<th>sp \\ co</th><th>0 to 40 %</th><th>40 to 100 %</th>" in text
