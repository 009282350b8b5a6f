"""retuner audit: what a plant's files hold, rows that are kept, the ranked page, and what breaks on the way."""

import json
import os
import shutil
import signal
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from audit_work import dies_or_works
from command_line import answer, printed, refused
from pi_loop import Lag, pi_loop
from plain_recording import read_recording

from retuner.audit.catalogue import Task, catalogue, files_of
from retuner.audit.loop_row import SCHEMA, AuditSettings, Row, audit_task, drawn, is_fault
from retuner.audit.ranked_loops import change, ranked, summary, write_results
from retuner.audit.result_store import ResultStore, rows_of
from retuner.audit.working import expected, on_a_cluster, on_this_machine
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.recorded.recording import RecordingError
from retuner.errors import UserError
from retuner.schedule.controller_units import ControllerUnits
from retuner.schedule.gains import PidGains

DATA = Path(__file__).parent.parent / "data"
VALVE = DATA / "plant" / "FIC20102_1016_12.csv"
FORM = RecordForm()
RNG = np.random.default_rng(3)


def table(path: Path, names: str, columns: int, rows: int = 300) -> Path:
    noise = RNG.normal(size=(rows, columns)) + 50
    lines = [",".join([str(10 * i), *(f"{v:.3f}" for v in row)]) for i, row in enumerate(noise)]
    path.write_text(names + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    folder = tmp_path / "plant"
    (folder / "unit").mkdir(parents=True)
    table(folder / "unit" / "wide.csv", "t,A.SP,A.PV,A.OP,B.SP,B.PV,B.OP,C.PV", 7)
    table(folder / "D.PV.csv", "t,value", 1)
    table(folder / "D.OP.csv", "t,value", 1)
    table(folder / "FIC7_monday.csv", "t,sp,pv,co", 3)
    table(folder / "FIC7_tuesday.csv", "t,sp,pv,co", 3)
    (folder / "notes.txt").write_text("no record\n", encoding="utf-8")
    (folder / "half.csv").write_text("t,sp,pv,co\n0,1,2", encoding="utf-8")
    return folder


def test_the_catalogue_finds_loops_in_whatever_holds_them(plant: Path) -> None:
    found = catalogue(files_of([plant]), FORM, r"^([A-Z]+\d+)_")
    by_tags = {task.tags: task for task in found.tasks}

    assert set(by_tags) == {("A", "B"), ("D",), ("FIC7",)} | {tags for tags in by_tags if tags == ("half",)}
    assert len(by_tags["FIC7",].files) == 2
    assert by_tags["FIC7",].separate
    assert {path.name for path in by_tags["D",].files} == {"D.PV.csv", "D.OP.csv"}
    assert any("notes.txt" in reason for _, reason in found.refused)
    assert any(reason.startswith("C: no co") for _, reason in found.refused)


def test_a_long_table_is_looked_through_for_its_tags(tmp_path: Path) -> None:
    rows = [f"X.{role},{10 * i},{50 + i % 3}" for i in range(30) for role in ("PV", "SP", "OP")]
    path = tmp_path / "long.csv"
    path.write_text("tag,time,value\n" + "\n".join(rows) + "\n", encoding="utf-8")

    assert catalogue([path], FORM).tags == ("X",)


def test_a_loop_is_not_two_of_one_name(tmp_path: Path) -> None:
    table(tmp_path / "X.csv", "t,sp,pv,co", 3)
    table(tmp_path / "wide.csv", "t,X.SP,X.PV,X.OP", 3)
    found = catalogue(files_of([tmp_path]), FORM)

    assert found.tags == ("X",)
    assert [path.name for path, reason in found.refused if "--tag-pattern" in reason] == ["X.csv"]


def test_files_are_found_by_pattern_and_a_missing_one_is_told(plant: Path) -> None:
    assert [p.name for p in files_of([plant / "FIC7_*.csv"])] == ["FIC7_monday.csv", "FIC7_tuesday.csv"]
    with pytest.raises(RecordingError, match="no such file or folder"):
        files_of([plant / "nowhere"])


def test_a_real_valve_is_sent_to_the_workshop_and_never_retuned() -> None:
    (row,) = audit_task(Task(("FIC20102",), (VALVE,), separate=True), AuditSettings(2))

    assert (row["cause"], row["action"]) == ("stiction", "repair the valve")
    assert row["settings"] is None
    json.dumps(row, allow_nan=False)


def test_a_record_that_cannot_be_used_is_a_row_with_the_reason(plant: Path) -> None:
    rows = audit_task(Task(("half",), (plant / "half.csv",), separate=True), AuditSettings(1))
    assert "half.csv" in str(rows[0]["failed"])


def test_a_loop_without_setpoint_is_screened_for_what_can_be_told_without_it(plant: Path) -> None:
    task = Task(("D",), (plant / "D.PV.csv", plant / "D.OP.csv"))
    (row,) = audit_task(task, AuditSettings(1))

    assert row["action"] == "export its setpoint"
    assert "no setpoint in the record" in str(row["reason"])
    assert row["stretches"] == []
    assert (row["loss_per_day"], row["screen"]["iae_per_day"], row["screen"]["harris"]) == (None, None, None)
    assert row["screen"]["effort_per_day"] > 0
    (row,) = audit_task(task, AuditSettings(1, RecordForm(sp=50.0)))
    assert row["screen"]["iae_per_day"] > 0
    assert len(row["stretches"]) == 1


def test_a_loop_without_setpoint_that_oscillates_asks_for_a_visit(tmp_path: Path) -> None:
    t = 10.0 * np.arange(3000)
    wave = 50 + 3 * np.sin(2 * np.pi * t / 400) + RNG.normal(0, 0.1, len(t))
    rows = [f"{a:g},{b:.4f},{c:.4f}" for a, b, c in zip(t, wave, 60 - wave, strict=True)]
    path = tmp_path / "blind.csv"
    path.write_text("t,pv,co\n" + "\n".join(rows) + "\n", encoding="utf-8")
    (row,) = audit_task(Task(("blind",), (path,), separate=True), AuditSettings(1))

    assert (row["cause"], row["action"]) == ("unknown", "inspect")
    assert row["screen"]["period_s"] == pytest.approx(400, rel=0.02)
    assert is_fault(row)


def test_a_trend_is_drawn_without_losing_a_peak() -> None:
    window = read_recording(VALVE).window()
    thin = drawn(window, 100)

    assert len(thin["pv"]) <= 100
    assert max(thin["pv"]) == pytest.approx(float(window.pv.max()), rel=1e-5)
    assert min(thin["co"]) == pytest.approx(float(window.co.min()), rel=1e-5)


def row(tag: str, rank: float, cause: str = "aggressive", **more: object) -> Row:
    return {"schema": 1, "tag": tag, "rank": rank, "cause": cause, "action": "retune", "avoidable": 0.5, **more}


def swinging(period_s: float) -> dict[str, object]:
    return {"period_s": period_s, "swinging": 1.0}


def test_rows_are_ranked_and_what_comes_from_another_loop_waits_for_it() -> None:
    rows = [
        row("upset", 0.9, "external", screen=swinging(100.0)),
        row("valve", 0.5, "stiction", screen=swinging(101.0), sticks=0.8),
        row("calm", 0.0, "ok"),
    ]
    listed, groups = ranked(rows, [row("valve", 0.1, "ok"), row("calm", 0.0, "ok")])

    assert [r["tag"] for r in listed] == ["valve", "upset", "calm"]
    assert listed[1]["action"] == "look at valve first"
    assert groups[0].root == "valve"
    assert [r["change"] for r in listed] == ["worse: was ok", "new", "same"]


def test_what_became_of_a_loop_is_told_by_its_faults_and_its_error() -> None:
    then = row("x", 0.5, screen={"iae_per_day": 100.0})

    assert change(then, None) == "new"
    assert change(row("x", 0.1, screen={"iae_per_day": 120.0}), then) == "same"
    assert change(row("x", 0.1, screen={"iae_per_day": 250.0}), then) == "worse: error 2.5 times"
    assert change(row("x", 0.1, screen={"iae_per_day": 20.0}), then) == "better: error 0.2 times"
    assert change(row("x", 0.0, "ok", screen={"iae_per_day": 300.0}), then) == "better: was aggressive"
    assert change(row("x", 0.4, "stiction", screen={"iae_per_day": None}), then) == "was aggressive"


@pytest.mark.parametrize(
    "other",
    [
        {"action": "screened only"},
        {"action": "the same record as y"},
        {"action": "read the reason", "cause": "failed", "failed": "no such file"},
    ],
)
def test_how_far_an_audit_looked_is_no_change_of_a_loop(other: dict[str, object]) -> None:
    sick = row("x", 0.5, "stiction", screen={"iae_per_day": 100.0})
    untold = row("x", 0.0, "unknown", screen={"iae_per_day": 110.0}) | other
    worse = untold | {"screen": {"iae_per_day": 300.0}}

    assert change(untold, sick) == "not diagnosed now"
    assert change(sick, untold) == "not diagnosed then"
    assert change(worse, untold) == "worse: error 2.7 times, not diagnosed then or now"


@pytest.mark.parametrize("schema", [1, 2, 3])
def test_an_audit_of_an_earlier_program_is_compared_and_one_of_a_later_refused(tmp_path: Path, schema: int) -> None:
    then = row("x", 0.5, screen={"iae_per_day": 100.0}) | {"schema": schema, "trend": {}}
    with ResultStore(tmp_path) as store:
        store.keep([then], "signed")
    (before,) = rows_of(tmp_path)
    listed, _ = ranked([row("x", 0.1, screen={"iae_per_day": 250.0})], [before])
    assert listed[0]["change"] == "worse: error 2.5 times"
    with ResultStore(tmp_path) as store:
        store.keep([then | {"schema": SCHEMA + 1}], "signed")
    with pytest.raises(UserError, match=f"of schema {SCHEMA + 1}, this program knows 1 to {SCHEMA}"):
        rows_of(tmp_path)


def test_dated_files_of_one_tag_are_one_loop_and_numbered_ones_are_not(tmp_path: Path) -> None:
    for name in ("FIC101_0614.csv", "FIC101_2024-11-02_2.csv", "FIC102_1.csv", "FIC102_2.csv", "day_20240101.csv"):
        table(tmp_path / name, "t,sp,pv,co", 3, rows=10)
    found = catalogue(files_of([tmp_path]), FORM)

    assert {task.tags[0]: len(task.files) for task in found.tasks} == {
        "FIC101": 2,
        "FIC102_1": 1,
        "FIC102_2": 1,
        "day_20240101": 1,
    }


def test_the_root_of_a_group_is_not_sent_upstream() -> None:
    rows = [
        row("upset", 0.9, "external", screen=swinging(100.0)),
        row("valve", 0.5, "external", screen=swinging(101.0), sticks=0.3, reason="comes from elsewhere"),
    ]
    listed, _ = ranked(rows)

    assert (listed[0]["tag"], listed[0]["action"]) == ("valve", "inspect")
    assert "probably caused here: its valve sticks" in str(listed[0]["reason"])


def test_names_cannot_leave_the_page(tmp_path: Path) -> None:
    write_results(tmp_path, [row("</script><script>alert(1)", 0.5, reason="<b>")], [], [])

    assert "</script><script>alert" not in (tmp_path / "audit-data.js").read_text(encoding="utf-8")
    assert "<" not in (tmp_path / "loops" / "1.js").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "audit.json").read_text(encoding="utf-8"))["rows"][0]["place"] == 1


def test_an_audit_goes_on_where_it_was(tmp_path: Path) -> None:
    folder, out = tmp_path / "plant", tmp_path / "out"
    folder.mkdir()
    table(folder / "A.csv", "t,sp,pv,co", 3)
    (folder / "B.csv").write_text("t,sp,pv,co\n0,1,2,3\n", encoding="utf-8")
    arguments = ["audit", str(folder), "--out", str(out), "--jobs", "1", "--stretches", "1"]
    document = answer(*arguments)
    assert {r["tag"] for r in document["rows"]} == {"A", "B"}
    with ResultStore(out) as store:
        before = store.done()
    table(folder / "A.csv", "t,sp,pv,co", 3, rows=310)
    assert "deserve a visit" in printed(*arguments, "--since", out)
    with ResultStore(out) as store:
        after = store.done()
    assert after["B"] == before["B"]
    assert after["A"] != before["A"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--stretches", "25"], "stretches = 25: give 0 to 24"),
        (["--since", "nowhere"], "no audit in it"),
        (["--tag-pattern", "("], "--tag-pattern"),
        (["--diagnose", "101"], "--diagnose 101: give 0 to 100 percent"),
    ],
)
def test_wrong_options_end_in_one_line(tmp_path, arguments, message):
    table(tmp_path / "A.csv", "t,sp,pv,co", 3)
    assert message in refused("audit", tmp_path, "--out", tmp_path / "out", *arguments)


def test_a_wrong_name_is_told_as_one_of_its_file(tmp_path: Path) -> None:
    names = tmp_path / "names.toml"
    names.write_text('[record]\nsignals = { "A.PV" = 7 }\n', encoding="utf-8")
    assert refused("audit", tmp_path, "--out", tmp_path / "out", "--record", names).startswith(
        f"{names}: [record] signals"
    )


def test_a_folder_without_a_loop_and_an_audit_of_another_version_are_told(tmp_path):
    (tmp_path / "x.csv").write_text("nothing here\n", encoding="utf-8")
    assert "no loop found, none in its 1 file" in refused("audit", tmp_path)
    with ResultStore(tmp_path / "old") as store:
        store.keep([{**row("A", 1.0), "schema": 99}], "x")
    with pytest.raises(UserError, match="of schema 99"):
        rows_of(tmp_path / "old")


@pytest.mark.slow
def test_a_process_that_dies_costs_its_own_loop_only() -> None:
    tasks = [Task((name,), ()) for name in ("a", "killer", "b", "c")]
    rows = {str(r["tag"]): r for _, some in on_this_machine(tasks, AuditSettings(), 2, dies_or_works) for r in some}

    assert set(rows) == {"a", "killer", "b", "c"}
    assert "died twice" in str(rows["killer"]["failed"])
    assert all("failed" not in rows[name] for name in "abc")


@pytest.mark.nightly
def test_a_cluster_whose_worker_is_killed_does_all_the_work(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    copies = [Path(shutil.copy(VALVE, tmp_path / f"loop{i}.csv")) for i in range(6)]
    tasks = [Task((path.stem,), (path,), separate=True) for path in copies]
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "local_directory": str(tmp_path)}
    rows: list[Row] = []
    with distributed.LocalCluster(processes=True, **options) as cluster:
        before = {worker.pid for worker in cluster.workers.values()}
        for _, some in on_a_cluster(tasks, AuditSettings(1), cluster.scheduler_address):
            if not rows:
                os.kill(next(iter(before)), signal.SIGKILL)
            rows += some
        after = {worker.pid for worker in cluster.workers.values()}

    assert sorted(str(row["tag"]) for row in rows) == sorted(task.tags[0] for task in tasks)
    assert not [row["failed"] for row in rows if "failed" in row]
    assert after != before


def test_a_cluster_does_the_same_work() -> None:
    distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")
    task = Task(("FIC20102",), (VALVE,), separate=True)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        ((done, rows),) = on_a_cluster([task], AuditSettings(1), cluster.scheduler_address)
    assert done == task
    assert rows[0]["cause"] == "stiction"


@pytest.mark.slow
def test_a_share_of_the_loops_is_diagnosed_those_that_the_screening_shows_worst(plant, tmp_path):
    shutil.copy(VALVE, plant / "valve.csv")
    arguments = ["audit", str(plant), "--out", str(tmp_path / "out"), "--jobs", "1", "--stretches", "1", "--json"]

    def diagnosed(*more: str) -> set[str]:
        rows = json.loads(printed(*arguments, *more))["rows"]
        return {row["tag"] for row in rows if row.get("looked_at")}

    assert diagnosed("--diagnose", "0") == set()
    assert diagnosed("--diagnose", "17") == {"valve"}
    with ResultStore(tmp_path / "out") as store:
        before = store.done()
    assert diagnosed("--diagnose", "17") == {"valve"}
    assert {"valve", "A", "B"} <= diagnosed()
    with ResultStore(tmp_path / "out") as store:
        after = store.done()
    assert after["valve"] == before["valve"]
    assert after["A"] != before["A"]


def test_a_long_audit_is_foretold() -> None:
    assert expected(100, 4, 1.0, 2) == ""
    told = expected(10_000, 4, 1.0, 2)
    assert "10000 loops, 100% of them diagnosed on up to 4 stretches of each record: about 1.7 h on 2 cores" in told
    assert "--diagnose 20 takes the worst of them only, about 24 min" in told
    assert "--diagnose" not in expected(10_000, 4, 0.2, 1)


def test_a_loop_that_was_exported_under_two_tags_is_visited_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    pv, co = 50 + rng.normal(size=3_000), np.cumsum(rng.normal(size=3_000))
    rows = [f"{10 * i},50,{p:.3f},{c:.3f},50,{p:.3f},{c:.3f}" for i, (p, c) in enumerate(zip(pv, co, strict=True))]
    path = tmp_path / "both.csv"
    path.write_text("t,A.SP,A.PV,A.OP,B.SP,B.PV,B.OP\n" + "\n".join(rows) + "\n", encoding="utf-8")
    listed, groups = ranked(audit_task(Task(("A", "B"), (path,)), AuditSettings(0)))
    again = {row["tag"]: row for row in listed}["B"]
    assert (again["action"], again["rank"], groups) == ("the same record as A", 0.0, [])
    assert "exported twice" in again["reason"]
    assert "1 is another loop's record again" in summary(listed, 0)


def test_the_list_as_a_table_has_a_row_a_loop_whatever_each_knows(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [row("A", 0.5, screen={"harris": 0.3}), row("B", 0.2, reason="none"), row("C", 0.1, screen={"gaps": 2})]
    write_results(tmp_path, rows, [], [])
    table_of = parquet.read_table(tmp_path / "audit.parquet").to_pydict()

    assert table_of["tag"] == ["A", "B", "C"]
    assert table_of["screen_harris"] == [0.3, None, None]
    assert table_of["screen_gaps"] == [None, None, 2]
    assert table_of["reason"] == [None, "none", None]


def test_a_plant_is_told_week_by_week_by_area(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    lines = ["time,FIC46001.SP,FIC46001.PV,FIC46001.OP,TI.SP,TI.PV,TI.OP"]
    for i in range(3 * 7 * 144):
        pv, co = 50 + rng.normal(), 40.0 if i >= 2 * 7 * 144 else 50 + 8 * rng.normal()
        when = datetime(2026, 3, 2, tzinfo=UTC) + timedelta(minutes=10 * i)
        lines.append(f"{when:%Y-%m-%d %H:%M},50,{pv:.3f},{co:.3f},50,{pv:.3f},{co:.3f}")
    path = tmp_path / "both.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    rows = audit_task(Task(("FIC46001", "TI"), (path,)), AuditSettings(0))
    write_results(tmp_path, rows, [], [])
    told = json.loads((tmp_path / "audit.json").read_text(encoding="utf-8"))["over_time"]
    assert [(one["area"], one["begin"], one["loops"], one["in_automatic"]) for one in told] == [
        (area, begin, loops, share)
        for area, loops in (("all", 2), ("46", 1))
        for begin, share in (("2026-03-02", 1.0), ("2026-03-09", 1.0), ("2026-03-16", pytest.approx(0.0, abs=0.01)))
    ]
    assert all(part["days"] == 7 for part in told)


def test_the_page_knows_whose_controllers_they_are(tmp_path: Path) -> None:
    write_results(tmp_path, [row("A", 0.5)], [], [], controller=ControllerUnits.named("deltav-standard", pv_span=200.0))
    assert '"controller": {"name": "deltav-standard", "span": 200.0}' in (tmp_path / "audit-data.js").read_text()
    assert "give --pv-span" in refused("audit", tmp_path, "--controller", "deltav-standard")


@pytest.mark.slow
@pytest.mark.parametrize(("after", "action"), [(4.0, "retune"), (1.0, "nothing")])
def test_a_loop_is_judged_by_its_newest_settings_and_retuned_where_diagnose_has_settings(
    tmp_path: Path, after: float, action: str
) -> None:
    """Tight in both halves of its record, or calmed between them and back in order."""
    halves = []
    for kc, seed in ((4.0, 1), (after, 2)):
        rng, at = np.random.default_rng(seed), np.arange(1000)
        load, sp = np.cumsum(rng.standard_normal(1000)) * 0.1, np.where((at > 150) & (at < 300), 4.0, 0.0)
        halves.append(pi_loop(PidGains(kc, kc / 20.0), Lag(20.0, 4), sp, 0.02 * rng.standard_normal(1000), load))
    sp, pv, co = (np.concatenate([getattr(one, name) for one in halves]) for name in ("sp", "pv", "co"))
    path = tmp_path / "TIC1.csv"
    np.savetxt(path, np.column_stack([np.arange(2000.0), sp, pv, co]), delimiter=",", header="t,sp,pv,co", comments="")
    (found,) = audit_task(Task(("TIC1",), (path,), separate=True), AuditSettings())
    assert found["action"] == action
    assert (found["settings"] is not None) == (action == "retune")
    assert "No settings" not in str(found["reason"])
