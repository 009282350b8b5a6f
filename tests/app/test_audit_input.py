"""retuner audit on input that nobody tidied: broken and cut files, zones, mixed rates, an empty folder, Ctrl-C."""

import json
from pathlib import Path

import numpy as np
import pytest

from retuner.audit import working
from retuner.audit.catalogue import Task
from retuner.audit.loop_row import AuditSettings, Row, audit_task
from retuner.audit.result_store import ResultStore
from retuner.cli import main

RNG = np.random.default_rng(19)
SCREEN = ("--jobs", "1", "--stretches", "0", "--json")


def record(path: Path, rows: int = 60) -> Path:
    noise = RNG.normal(size=(rows, 2))
    lines = [f"{10 * i},50,{50 + a:.3f},{40 + b:.3f}" for i, (a, b) in enumerate(noise)]
    path.parent.mkdir(exist_ok=True)
    path.write_text("t,sp,pv,co\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def audited(
    folder: Path, out: Path, capsys: pytest.CaptureFixture[str], *more: str
) -> tuple[dict[str, Row], list[dict[str, str]]]:
    assert main(["audit", str(folder), "--out", str(out), *SCREEN, *more]) == 0
    document = json.loads(capsys.readouterr().out)
    return {row["tag"]: row for row in document["rows"]}, document["refused"]


def test_two_broken_files_of_a_hundred_cost_two_rows_or_lines(tmp_path, capsys):
    plant = tmp_path / "plant"
    whole = [record(plant / f"FIC{i:03d}.csv") for i in range(100)]
    whole[17].write_bytes(RNG.bytes(3000))
    whole[42].write_text(whole[42].read_text(encoding="utf-8").replace("\n100,", "\nrubbish,"), encoding="utf-8")
    rows, refused = audited(plant, tmp_path / "out", capsys)

    broken = {tag for tag, row in rows.items() if "failed" in row} | {Path(one["file"]).stem for one in refused}
    assert broken == {"FIC017", "FIC042"}
    assert len(rows) >= 98
    assert all("FIC" in str(row["failed"]) for row in rows.values() if "failed" in row)


def test_a_file_that_was_cut_in_half_is_used_as_far_as_it_goes_or_told(tmp_path, capsys):
    plant = tmp_path / "plant"
    record(plant / "whole.csv")
    text = record(plant / "half.csv").read_bytes()
    (plant / "half.csv").write_bytes(text[: len(text) // 2 + 3])
    rows, refused = audited(plant, tmp_path / "out", capsys)

    assert rows["whole"]["screen"]["samples"] == 60
    half = rows.get("half", {"failed": [one["reason"] for one in refused]})
    assert "half.csv" in str(half["failed"]) if "failed" in half else half["screen"]["samples"] in {29, 30, 31}


def test_stamps_of_several_zones_are_one_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = tmp_path / "plant"
    record(plant / "counted.csv")
    utc = np.datetime64("2024-03-31T00:30:00") + (60 * np.arange(90)).astype("timedelta64[s]")
    local = [str(t + np.timedelta64(1 + (t >= np.datetime64("2024-03-31T01:00:00")), "h")) for t in utc]
    for name, stamps in (("utc", [f"{t}Z" for t in utc]), ("berlin", local), ("offset", [f"{t}+00:00" for t in utc])):
        lines = [f"{t},50,{50 + i % 7},{i % 5}" for i, t in enumerate(stamps)]
        (plant / f"{name}.csv").write_text("time,sp,pv,co\n" + "\n".join(lines) + "\n", encoding="utf-8")
    rows, _ = audited(plant, tmp_path / "out", capsys, "--zone", "Europe/Berlin")

    for name in ("utc", "berlin", "offset"):
        assert "failed" not in rows[name], rows[name]
        assert rows[name]["begin"] == "2024-03-31 00:30:00"
        assert rows[name]["end"] == "2024-03-31 01:59:00"
        assert rows[name]["screen"]["gaps"] == 0


def test_signals_of_other_rates_are_held_between_their_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = tmp_path / "plant"
    plant.mkdir()
    for role, every, level in (("PV", 1, 50.0), ("SP", 60, 50.0), ("OP", 7, 40.0)):
        values = [f"{i * every},{level + (role != 'SP') * RNG.normal():.3f}" for i in range(1200 // every)]
        (plant / f"FIC1.{role}.csv").write_text("t,value\n" + "\n".join(values) + "\n", encoding="utf-8")
    rows, _ = audited(plant, tmp_path / "out", capsys)

    assert 1100 < rows["FIC1"]["screen"]["samples"] <= 1200
    assert sum("held between them" in told for told in rows["FIC1"]["assumed"]) == 2


def test_an_audit_that_is_stopped_keeps_what_is_done_and_goes_on(tmp_path, capsys, monkeypatch):
    plant, out, done = tmp_path / "plant", tmp_path / "out", list[str]()
    for i in range(5):
        record(plant / f"FIC{i}.csv")

    def counted(task: Task, settings: AuditSettings) -> list[Row]:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(task.tags[0])
        return audit_task(task, settings)

    monkeypatch.setattr(working, "audit_task", counted)
    assert main(["audit", str(plant), "--out", str(out), *SCREEN]) == 130
    told = capsys.readouterr()
    assert "3 loops are left; the same command goes on" in told.err
    with ResultStore(out) as store:
        assert set(store.done()) == set(done)
    assert len(json.loads((out / "audit.json").read_text(encoding="utf-8"))["rows"]) == 2
    first, done[:] = list(done), []
    monkeypatch.setattr(
        working, "audit_task", lambda task, settings: done.append(task.tags[0]) or audit_task(task, settings)
    )
    rows, _ = audited(plant, out, capsys)
    assert sorted(rows) == sorted(first + done)
    assert len(done) == 3


def test_a_broken_file_of_a_loop_of_several_is_told_in_its_row(tmp_path: Path) -> None:
    good, bad = tmp_path / "FIC1_2024.csv", tmp_path / "FIC1_2025.csv"
    rows = "".join(f"{i},50,{50 + i % 7},{40 + i % 5}\n" for i in range(300))
    good.write_text("t,sp,pv,co\n" + rows, encoding="utf-8")
    bad.write_text("t,sp,pv,co\n1,2,x,3\n", encoding="utf-8")
    (row,) = audit_task(Task(("FIC1",), (good, bad), separate=True), AuditSettings(0))
    assert row["records"] == 1
    assert any("left out" in str(told) and "FIC1_2025.csv:2" in str(told) for told in list(row["assumed"]))
