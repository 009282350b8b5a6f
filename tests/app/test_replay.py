"""retuner replay of a session: the same bytes again, and every way in which it cannot be, told in one line."""

import itertools
import json
import re
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from command_line import answer, printed, refused
from effort import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recorded import SHORT, bodies, rewritten, run_short, short_session

from retuner import GainTable, LoopSample, PidGains, Regions, Retuner, RetunerSettings
from retuner.adaptive.fit.engine import engine_name
from retuner.cli import main
from retuner.commands.replay import IN_FORCE_SAMPLES, InForce
from retuner.drivers.bus import bus_opening
from retuner.drivers.bus.bus_opening import log_parts
from retuner.drivers.recorded.frame_log import read_frames
from retuner.errors import UserError
from retuner.ledger.chain import Row
from retuner.replay.replaying import first_difference, recorded_columns
from retuner.session import bench_or_buses, outputs
from retuner.session.outputs import read_loops


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which gains are changed."""
    folder = tmp_path_factory.mktemp("replay") / "run"
    shutil.copytree(short_session(tmp_path_factory, "--mode", "auto"), folder)
    assert len(bodies(folder, "committed")) >= 1
    return folder


def replayed(session: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    status = main(["replay", str(session), "--json"])
    return status, json.loads(capsys.readouterr().out)


def without_end(row: Row) -> dict[str, Any] | None:
    return None if row.kind == "end" else row.body


@pytest.mark.uncounted
def test_a_session_is_decided_again_byte_for_byte(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = replayed(session, capsys)
    assert (status, found["identical"], found["first_difference"]) == (0, True, None)
    recorded = bodies(session, "decision")
    assert found["compared"] == len(recorded) >= 2
    assert found["decisions"] == [{k: v for k, v in body.items() if k != "samples"} for body in recorded]
    assert found["samples"] == bodies(session, "end")[0]["samples"] >= 800


def test_the_configuration_is_kept_as_it_was_run(session: Path) -> None:
    text = (session / "config.toml").read_text()
    assert 'mode = "auto"  # by the command line; the file says: mode = "advise"' in text
    changed = [then for now, then in zip(text.splitlines(), SHORT.splitlines(), strict=True) if now != then]
    assert changed == ['mode = "advise"  # the command line may say more']
    first = bodies(session, "session")[0]
    assert first["overrides"] == {"adaptation.mode": "auto"}
    assert first["seed"] == 3
    assert set(first["versions"]) == set(outputs.versions())


@pytest.mark.uncounted
def test_the_session_of_the_kept_configuration_is_the_same_again(session: Path, tmp_path: Path) -> None:
    assert main(["run", str(session / "config.toml"), "--out", str(tmp_path / "run"), "--no-compare"]) == 0
    assert bodies(tmp_path / "run", "decision") == bodies(session, "decision")
    assert bodies(tmp_path / "run", "end") == bodies(session, "end")


def test_another_decision_is_named_with_key_and_both_values(session, tmp_path, capsys):
    def worse(row: Row) -> dict[str, Any]:
        body = row.body
        if row.kind == "decision":
            body["verdict" if body["verdict"] else "diagnosis"] = {"forged": 1}
        return body

    forged = rewritten(session, tmp_path / "forged", worse)
    capsys.readouterr()
    assert main(["replay", str(forged)]) == 1
    assert re.search(
        r"different: decision 1 \(row \d+\), verdict\.\w+: recorded .*, replayed ", capsys.readouterr().out
    )


def test_a_decision_too_few_or_too_many_is_a_difference(session, tmp_path, capsys):
    few = rewritten(session, tmp_path / "few", lambda r: None if r.kind == "decision" else r.body)
    status, found = replayed(few, capsys)
    assert status == 1
    assert found["identical"] is False
    assert found["first_difference"]["recorded"] == "nothing"
    many = rewritten(session, tmp_path / "many", lambda r: {**r.body, "samples": 5} if r.kind == "decision" else r.body)
    assert replayed(many, capsys)[0] == 1


def test_an_event_that_was_taken_away_shows(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    forged = rewritten(session, tmp_path / "forged", lambda r: None if r.kind == "committed" else r.body)
    status, found = replayed(forged, capsys)
    assert status == 1
    assert found["first_difference"]["decision"] == 2


def test_other_versions_are_named_where_the_decisions_differ(session, tmp_path):
    def older(row: Row) -> dict[str, Any]:
        body = row.body
        if row.kind == "session":
            body["versions"]["numpy"] = "0.1"
        if row.kind == "decision":
            body["records"] = 77
        return body

    told = printed("replay", str(rewritten(session, tmp_path / "older", older)), status=1).splitlines()
    assert "records: recorded 77" in told[0]
    assert told[1].startswith("byte identity is claimed for equal versions only")
    assert "numpy 0.1 then" in told[1]


def test_a_changed_bus_log_is_found(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(session, copy)
    raw = bytearray((copy / "bus.blf").read_bytes())
    raw[-9] ^= 1
    (copy / "bus.blf").write_bytes(raw)
    status, found = replayed(copy, capsys)
    assert status == 1
    assert "was changed after it" in found["reason"]
    assert found["first_difference"] is None


def in_parts(folder: Path, frames_a_look: int) -> Path:
    """A session whose bus log is put aside at each look at its size."""
    folder.mkdir()
    small = bench_or_buses.link_settings
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench_or_buses, "link_settings", lambda *given: replace(small(*given), log_bytes_max=2.0))
        patch.setattr(bus_opening, "LOOK_EVERY", frames_a_look)
        return run_short(folder, "--mode", "auto")


@pytest.mark.slow
def test_a_bus_log_in_parts_is_one_log_until_its_beginning_is_gone(session, tmp_path, capsys):
    frames = len(list(read_frames(session / "bus.blf")))
    whole = in_parts(tmp_path / "whole", frames * 2 // 3)
    assert len(list(whole.glob("bus*.blf"))) == 2
    status, found = replayed(whole, capsys)
    assert (status, found["identical"], found["samples"]) == (0, True, bodies(session, "end")[0]["samples"])
    cut = in_parts(tmp_path / "cut", frames // 4)
    assert [path.name for path in log_parts(cut / "bus.blf").paths][1:] == ["bus.blf"]
    status, found = replayed(cut, capsys)
    assert (status, found["identical"], found["compared"]) == (1, False, 0)
    assert re.search(r"bus\.blf: its beginning is gone, [34] full parts?, .* bus_log_mb = 256$", found["reason"])
    (cut / "trend.csv").unlink()
    columns = recorded_columns(read_loops(cut)[0][0])
    assert np.all(np.diff(columns["t"]) > 0)
    assert len(columns["t"]) > 100
    assert columns["t"][-1] == pytest.approx(recorded_columns(read_loops(session)[0][0])["t"][-1])
    (whole / "bus-1.blf").unlink()
    assert "is not the log of this session" in replayed(whole, capsys)[1]["reason"]


def test_a_bus_log_that_is_not_there_is_bad_input(session, tmp_path):
    copy = tmp_path / "no log"
    shutil.copytree(session, copy)
    (copy / "bus.blf").unlink()
    assert "bus.blf: no such file" in refused("replay", copy)


@pytest.mark.slow
def test_missing_frames_are_found_where_they_are_missing(session, tmp_path, capsys):
    """A killed session has no hash of its log: the places of the rows say what is missing."""
    copy = rewritten(session, tmp_path / "copy", without_end)
    frames = list(read_frames(copy / "bus.blf"))
    for name, kept in (("middle", frames[:400] + frames[600:]), ("end", frames[: len(frames) // 4])):
        with can.Logger(copy / "bus.blf") as writer:
            for frame in kept:
                writer.on_message_received(frame)
        status, found = replayed(copy, capsys)
        assert status == 1
        assert ("lacks frames: row " if name == "middle" else "ends after sample ") in found["reason"]
        assert found["identical"] is False


def test_a_killed_session_is_replayed_as_far_as_it_went(session, tmp_path):
    killed = rewritten(session, tmp_path / "killed", without_end)
    shown = printed("replay", killed)
    assert "identical" in shown
    assert "killed, or goes on" in shown
    assert shown.count("\n") == 1


def test_a_changed_row_or_configuration_is_one_line(session, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(session, copy)
    with (copy / "config.toml").open("a") as stream:
        stream.write("# nothing\n")
    assert "config.toml: was changed after the run" in refused("replay", copy)
    with sqlite3.connect(copy / "ledger.sqlite") as connection:
        connection.execute("DROP TRIGGER no_update")
        connection.execute("UPDATE ledger SET body = '{}' WHERE seq = 3")
    connection.close()
    assert "row 3 was changed after it was written" in refused("replay", copy)


@pytest.mark.parametrize(
    ("name", "told"), [("none", "no such folder"), ("empty", "holds no ledger.sqlite"), ("log.blf", "give --config")]
)
def test_what_is_no_session_is_one_line(tmp_path, name, told):
    (tmp_path / "empty").mkdir()
    (tmp_path / "log.blf").write_bytes(b"")
    assert told in refused("replay", str(tmp_path / name))


def test_the_folder_of_one_of_several_loops_leads_to_the_ledger_of_all(tmp_path):
    loop = tmp_path / "run" / "loops" / "level"
    loop.mkdir(parents=True)
    (tmp_path / "run" / "ledger.sqlite").write_bytes(b"")
    assert f"the ledger of all loops is in {tmp_path / 'run'}: give that with --loop" in refused("ledger", "show", loop)


@pytest.mark.parametrize(
    ("then", "now", "found"),
    [
        ({"a": 1}, {"a": 1}, ""),
        ({"a": 1, "b": {"c": [1, 2]}}, {"a": 1, "b": {"c": [1, 3]}}, "b.c[1]"),
        ({"a": [1]}, {"a": [1, 2]}, "a[1]"),
        ({"a": 1}, {"b": 1}, "a"),
        ({"a": 1.0}, {"a": {"b": 1}}, "a"),
    ],
)
def test_the_first_difference_is_found(then: object, now: object, found: str) -> None:
    assert first_difference(then, now)[0] == found


def test_rows_that_no_session_writes_are_one_line(session, tmp_path, capsys):
    for kind, missing in (("committed", "gains"), ("link", "state")):

        def alien(row: Row, kind: str = kind, missing: str = missing) -> dict[str, Any] | None:
            if row.kind == "end":
                return None
            return {key: value for key, value in row.body.items() if row.kind != kind or key != missing}

        status, found = replayed(rewritten(session, tmp_path / kind, alien), capsys)
        assert status == 1
        assert "is not what a session of this release writes" in found["reason"]


@given(st.binary(min_size=1, max_size=64), st.integers(0, 1 << 20))
@settings(max_examples=examples(15), suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
def test_a_log_with_other_bytes_in_it_never_passes_for_the_session(session: Path, raw: bytes, at: int) -> None:
    whole = (session / "bus.blf").read_bytes()
    at %= len(whole)
    other = whole[:at] + raw + whole[at + len(raw) :]
    try:
        (session / "bus.blf").write_bytes(other)
        assert main(["replay", str(session)]) == int(other != whole)
    finally:
        (session / "bus.blf").write_bytes(whole)


def by_another_engine(session: Path, to: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """A copy of a session that another engine has recorded, with its decisions changed."""

    def changed(row: Row) -> dict[str, Any]:
        body = row.body
        if row.kind == "session":
            body["versions"]["engine"] = "abacus 1"
        elif row.kind == "decision":
            change(body)
        return body

    return rewritten(session, to, changed)


@pytest.mark.slow
def test_another_engine_is_asked_for_the_same_verdicts_and_not_for_the_same_bytes(session, tmp_path, capsys):
    def rounded(body: dict[str, Any]) -> None:
        body["numbers"] = {**body["numbers"], "rounded": 1e-9}

    copy = by_another_engine(session, tmp_path / "rounded", rounded)
    status, found = replayed(copy, capsys)
    assert (status, found["identical"], found["same_verdicts"]) == (0, False, True)
    assert found["engines"] == {"then": "abacus 1", "here": engine_name()}
    said = printed("replay", copy)
    assert "the same verdicts" in said
    assert f"by engine {engine_name()} instead of abacus 1" in said


@pytest.mark.slow
def test_another_engine_that_decides_otherwise_is_found(session, tmp_path, capsys):
    def other(body: dict[str, Any]) -> None:
        if body["gains_after"]:
            body["gains_after"]["kp"] *= 1.05

    status, found = replayed(by_another_engine(session, tmp_path / "other", other), capsys)
    assert (status, found["same_verdicts"]) == (1, False)
    assert found["first_difference"]["key"] == "gains_after.kp"


# retuner replay LOG --config: what would have been done on a log from anywhere; each time the same, none written.


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a configuration and the session of another run of it, in which gains were changed."""
    return short_session(tmp_path_factory, "--mode", "auto").parent


def asked(log: Path, config: Path, *more: str) -> dict[str, Any]:
    found: dict[str, Any] = answer("replay", log, "--config", config, *more)
    return found


@pytest.mark.slow
def test_a_trend_and_a_bus_log_answer_alike_and_twice_the_same(recorded, tmp_path):
    run, config = recorded / "run", recorded / "short.toml"
    live = bodies(run, "decision")[0]
    before = sorted(path.name for path in run.iterdir())
    trend, bus = asked(run / "trend.csv", config), asked(run / "bus.blf", config)
    assert {d["action"] for found in (trend, bus) for d in found["decisions"]} <= {"advise", "none"}
    assert trend["decisions"]
    changed = len([body for body in bodies(run, "committed") if body["why"] != "schedule"])
    for found in (trend, bus):
        first = found["decisions"][0]
        assert first["t_s"] == live["t_s"]
        assert first["action"] == "advise"
        assert first["gains_after"] == pytest.approx(live["gains_after"], rel=1e-6)
        assert len(found["gains_changed_s"]) == changed
    assert trend["samples"] <= bus["samples"] <= trend["samples"] + 2
    left = {path.name for path in run.iterdir() if not path.name.startswith("ledger")}
    assert left == {name for name in before if not name.startswith("ledger")}
    for suffix in (".log", ".asc", ".mf4"):
        other = tmp_path / f"bus{suffix}"
        with can.Logger(other) as writer:
            for message in read_frames(run / "bus.blf"):
                writer.on_message_received(message)
        again = asked(other, config)["decisions"]
        assert [d["gains_after"] for d in again] == [d["gains_after"] for d in bus["decisions"]], suffix
        assert [d["reason"] for d in again] == [d["reason"] for d in bus["decisions"]], suffix


@pytest.mark.slow
def test_the_library_of_mf4_waits_until_one_is_read(tmp_path: Path) -> None:
    log = tmp_path / "bus.mf4"
    with can.Logger(log) as writer:
        for i in range(3):
            writer.on_message_received(can.Message(arbitration_id=i, timestamp=0.1 * i, is_extended_id=False))
    script = f"""if True:
        import sys
        from pathlib import Path
        from retuner.cli import main
        main(["--version"])
        from retuner.drivers.recorded.frame_log import read_frames
        print("pandas" in sys.modules, len(list(read_frames(Path({str(log)!r})))), "pandas" in sys.modules)
        log = Path({str(tmp_path / "damaged.mf4")!r})
        log.write_bytes(b"MDF     4.10    " + bytes(90))
        list(read_frames(log))"""
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == "False 3 True"
    assert "RecordingError" in done.stderr.splitlines()[-1]


def test_text_says_that_nothing_was_written(recorded: Path) -> None:
    shown = printed("replay", recorded / "run" / "trend.csv", "--config", recorded / "short.toml").splitlines()
    assert "proposed: Kc 5 tau_I 4 s -> Kc" in shown[0]
    assert shown[-1].endswith("nothing was written")


@pytest.mark.slow
def test_one_change_of_the_records_gains_is_told_as_once(recorded, tmp_path):
    trend, config = recorded / "run" / "trend.csv", recorded / "short.toml"
    until_s = asked(trend, config)["gains_changed_s"][0] + 0.5
    head, *lines = trend.read_text().splitlines()
    log = tmp_path / "trend.csv"
    log.write_text("\n".join([head, *(line for line in lines if float(line.split(",")[0]) < until_s)]) + "\n")
    assert "the record's gains changed once; nothing was written" in printed("replay", log, "--config", config)


def test_a_bare_table_with_other_names_is_enough(recorded, tmp_path):
    lines = (recorded / "run" / "trend.csv").read_text().splitlines()
    bare = ["time;target;temp;out", *(";".join(line.split(",")[:4]) for line in lines[1:])]
    log = tmp_path / "bare.csv"
    log.write_text("\n".join(bare) + "\n")
    names = ["--columns", "t=time,sp=target,pv=temp,co=out"]
    found = asked(log, recorded / "short.toml", *names)
    assert found["gains_changed_s"] == []
    assert found["decisions"][0]["action"] == "advise"
    assert found["gains"][0]["kp"] == 5.0


@pytest.mark.slow
def test_an_export_is_replayed_as_the_plain_record_of_it(recorded, tmp_path, capsys):
    lines = (recorded / "run" / "trend.csv").read_text().splitlines()
    rows = [line.split(",")[:4] for line in lines[1:]]
    assert lines[0].split(",")[:4] == ["t", "sp", "pv", "co"]
    plain, export = tmp_path / "plain.csv", tmp_path / "export.csv"
    plain.write_text("\n".join(["t,sp,pv,co", *(",".join(row) for row in rows)]) + "\n")
    begin = datetime(2024, 3, 14, 6, tzinfo=UTC)
    stamped = [(begin + timedelta(seconds=float(row[0]) - float(rows[0][0])), *row[1:]) for row in rows]
    written = [f"{t:%d.%m.%Y %H:%M:%S.%f};{sp};{pv};{co}".replace(".", ",") for t, sp, pv, co in stamped]
    dots = [line.replace(",", ".", 2) for line in written]  # of the date
    export.write_text("\n".join(["Zeit;P1.SP;P1.PV;P1.OP", *dots]) + "\n")

    whole = asked(plain, recorded / "short.toml")["decisions"]
    main(["replay", str(export), "--config", str(recorded / "short.toml"), "--json", "--tag", "P1"])
    found = capsys.readouterr()

    assert 'pv is "P1.PV"' in found.err
    again = json.loads(found.out)["decisions"]
    assert [d["action"] for d in again] == [d["action"] for d in whole]
    assert whole
    for one, other in zip(again, whole, strict=True):  # stamps of a calendar are exact to 1e-7 s
        assert one["gains_after"] == pytest.approx(other["gains_after"], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("none.csv", None, "no such file"),
        ("other.csv", "t,pv,co\n0,1,1\n0.1,1,1\n0.2,1,1\n", 'no column "sp"'),
        ("slow.csv", "t,sp,pv,co\n0,1,1,1\n10,1,1,1\n20,1,1,1\n", "sampled every 10 s, loop.sample_time_s is 0.1 s"),
        ("back.csv", "t,sp,pv,co" + "\n0,1,1,1\n0.1,1,1,1\n0.2,1,1,1" * 2, "must increase"),
        ("two.csv", "t,sp,pv,co\n0,1,1,1\n0.1,1,1,1\n", "at least 3 samples, this one has 2"),
        ("huge.csv", "t,sp,pv,co\n0,1,1,1\n0.1,1,1e40,1\n0.2,1,1,1\n", "beyond"),
        ("kd.csv", "t,sp,pv,co,kp,ki,kd\n0,1,1,1,0,0,0\n0.1,1,1,1,0,0,0\n0.2,1,1,1,0,0,0\n", "sample 1"),
        ("junk.blf", "junk", "damaged after 0 frames"),
        ("empty.log", "", "no telemetry"),
    ],
)
def test_what_cannot_be_read_is_one_line(recorded, tmp_path, name, text, told):
    if text is not None:
        (tmp_path / name).write_text(text)
    assert told in refused("replay", str(tmp_path / name), "--config", recorded / "short.toml")


def test_another_node_a_folder_and_columns_of_a_bus_log_are_one_line(recorded, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(SHORT + "[bus]\nnode = 7\n")
    shutil.copy(recorded / "run" / "bus.blf", tmp_path / "bus.blf")
    for arguments, told in (
        ([str(tmp_path / "bus.blf"), "--config", str(other)], "is bus.node = 7 the right one"),
        ([str(recorded / "run"), "--config", str(other)], "without --config"),
        ([str(tmp_path / "bus.blf"), "--config", str(other), "--columns", "pv=x"], "--columns"),
        ([str(recorded / "run"), "--columns", "pv=x"], "--columns"),
    ):
        assert told in refused("replay", *arguments)


LOW, HIGH, NEW = PidGains(1.0, 0.1), PidGains(2.0, 0.2), PidGains(1.5, 0.15)


def test_recorded_gains_are_those_of_the_region_in_which_they_ran_for_a_while() -> None:
    table = GainTable("loop", Regions("sp", "-", ("low", "high"), 0.0, (50.0,), 100.0, 1.0, 0.0), (LOW, HIGH))
    retuner = Retuner(table, RetunerSettings(1.0, 100.0))
    in_force = InForce(retuner)
    times = itertools.count()

    def run(sp: float, gains: PidGains | None, n: int) -> int:
        changes = 0
        for _ in range(n):
            retuner.observe(LoopSample(float(next(times)), sp, sp, 30.0, 1, 0, sp))
            changes += in_force.adopt(gains)
        return changes

    assert run(20.0, LOW, 20) == 0
    assert run(20.0, None, 20) == 0
    assert run(20.0, NEW, 20) == 1
    assert retuner.table.gains == (NEW, HIGH)
    assert run(80.0, NEW, IN_FORCE_SAMPLES - 2) == 0  # the schedule has not written the other region's set yet
    assert run(80.0, HIGH, 20) == 0
    assert run(80.0, LOW, 20) == 1
    assert retuner.table.gains == (NEW, LOW)
    with pytest.raises(UserError, match="act against"):
        run(80.0, PidGains(-1.0, -0.1), 20)
