"""retuner replay LOG --config: what would have been done on a log from anywhere; each time the same, none written."""

import itertools
import json
import shutil
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import can
import pytest
from command_line import answer, printed, refused

from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.cli import main
from retuner.commands.replay import IN_FORCE_SAMPLES, InForce
from retuner.drivers.recorded.frame_log import read_frames
from retuner.errors import UserError
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

sys.path.append(str(Path(__file__).parent))

from recorded import SHORT, bodies, short_session


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
