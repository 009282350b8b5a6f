"""retuner audit on what plants keep: Parquet data sets wide and long, their own names, broken files, long records."""

from pathlib import Path

import numpy as np
import pytest
from command_line import printed

from retuner.audit.catalogue import Catalogue, catalogue, files_of
from retuner.audit.loop_row import AuditSettings, Row, audit_task
from retuner.cli import main
from retuner.drivers.historian import parquet_tables
from retuner.drivers.historian.loop_record import loop_in_pieces, read_loop_record
from retuner.drivers.historian.record_form import RecordForm, form_from_toml
from retuner.drivers.recorded.recording import RecordingError

pa = pytest.importorskip("pyarrow", reason="the extra [parquet] is not installed")
pq = pytest.importorskip("pyarrow.parquet")

FORM = RecordForm()
RNG = np.random.default_rng(12)
BEGIN = np.datetime64("2024-03-01T00:00:00", "ms")


def stamps(first: int, rows: int) -> np.ndarray:
    return BEGIN + (np.arange(first, first + rows) * 10_000).astype("timedelta64[ms]")


def signals(tags: str, rows: int) -> dict[str, np.ndarray]:
    walk = np.cumsum(RNG.normal(size=(rows, 3 * len(tags))), axis=0)
    names = [f"{tag}.{role}" for tag in tags for role in ("SP", "PV", "OP")]
    return {name: 50 + walk[:, i] for i, name in enumerate(names)}


def write(path: Path, columns: dict[str, object], **more: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path, **more)
    return path


def long(values: dict[str, np.ndarray], first: int = 0) -> dict[str, object]:
    rows = len(next(iter(values.values())))
    return {
        "tag": np.repeat(list(values), rows),
        "timestamp": np.tile(stamps(first, rows), len(values)),
        "value": np.concatenate(list(values.values())),
    }


def read(found: Catalogue, form: RecordForm = FORM) -> dict[str, Row]:
    return {str(row["tag"]): row for task in found.tasks for row in audit_task(task, AuditSettings(1, form))}


@pytest.mark.slow
def test_a_wide_data_set_by_days_is_read_column_by_column(tmp_path: Path) -> None:
    whole = signals("ABCDEF", 600)
    for day in range(3):
        part = {name: values[200 * day : 200 * (day + 1)] for name, values in whole.items()}
        write(tmp_path / f"date=2024-03-0{day + 1}" / "part-0.parquet", {"time": stamps(200 * day, 200), **part})
    found = catalogue(files_of([tmp_path]), FORM)
    rows = read(found)

    assert sorted(rows) == list("ABCDEF")
    assert {len(task.files) for task in found.tasks} == {3}
    assert {row["screen"]["samples"] for row in rows.values()} == {600}
    assert rows["A"]["begin"] == "2024-03-01 00:00:00"


def test_a_long_data_set_gives_what_the_wide_one_gives(tmp_path: Path) -> None:
    values = signals("AB", 400)
    wide = write(tmp_path / "wide.parquet", {"time": stamps(0, 400), **values})
    table = write(tmp_path / "long" / "all.parquet", long(values), row_group_size=500)
    for name, signal in values.items():
        folder = tmp_path / "by_tag" / f"tag={name}"
        write(folder / "part-0.parquet", {"timestamp": stamps(0, 400), "value": signal})
    expected = read_loop_record([wide], RecordForm(tag="B")).recording

    for source in (table, tmp_path / "by_tag"):
        got = read_loop_record([source], RecordForm(tag="B")).recording
        for name in ("t_s", "sp", "pv", "co"):
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
        assert sorted(read(catalogue(files_of([source]), FORM))) == ["A", "B"]


def test_row_groups_without_the_loop_are_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "long.parquet", long(signals("ABCDEFGH", 100)), row_group_size=300)
    file = pq.ParquetFile(path)

    assert list(parquet_tables._groups(file, "tag", {"C.PV"})) == [2]
    assert list(parquet_tables._groups(file, "tag", {"A.PV", "H.PV"})) == [0, 7]


def test_a_record_longer_than_a_piece_is_seen_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = signals("A", 1000)
    paths = [
        write(
            tmp_path / f"{i}.parquet",
            {"time": stamps(100 * i, 100), **{n: v[100 * i :][:100] for n, v in whole.items()}},
        )
        for i in range(10)
    ]
    pieces = list(loop_in_pieces(paths, FORM, "A", 250))

    assert [len(piece.recording.t_s) for piece in pieces] == [200] * 5
    one = write(tmp_path / "one" / "all.parquet", {"time": stamps(0, 1000), **whole})
    assert [len(piece.recording.t_s) for piece in loop_in_pieces([one], FORM, "A", 300)] == [300, 300, 300, 100]
    monkeypatch.setattr("retuner.audit.catalogue.MOST_ROWS", 300)
    monkeypatch.setattr("retuner.audit.loop_row.MOST_ROWS", 300)
    (row,) = read(catalogue([one], FORM)).values()
    assert (row["records"], row["screen"]["samples"]) == (4, 1000)
    assert row["trend"]["t_s"][-1] == 9990.0
    with pytest.raises(RecordingError, match="no values of B"):
        list(loop_in_pieces([one], FORM, "B", 300))


def test_a_plants_own_names_are_mended_in_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = dict(zip(("40FT7", "FIC7_SPX", "FIC7_CTRL"), signals("A", 300).values(), strict=True))
    write(tmp_path / "plant" / "x.parquet", {"time": stamps(0, 300), **signals("B", 300), **values})
    out = tmp_path / "out"
    arguments = ["audit", str(tmp_path / "plant"), "--out", str(out), "--jobs", "1", "--stretches", "1"]
    assert main(arguments) == 0
    assert "3 names belong to no loop" in capsys.readouterr().err
    told = (out / "names.toml").read_text(encoding="utf-8")
    assert '"B.PV" = "B.PV"' in told
    mended = told.replace("words = {}", 'words = { spx = "sp" }').replace('# "40FT7" = ""', '"40FT7" = "FIC7.PV"')
    mended = mended.replace('# "FIC7_CTRL" = ""', '"FIC7_CTRL" = "FIC7.OP"')
    (tmp_path / "names.toml").write_text(mended, encoding="utf-8")

    assert form_from_toml(tmp_path / "names.toml").called("FIC7_SPX") == "FIC7.SP"
    found = catalogue(files_of([tmp_path / "plant"]), form_from_toml(tmp_path / "names.toml"))
    assert sorted(found.tags) == ["B", "FIC7"]
    assert "of 2 loops" in printed(*arguments, "--record", tmp_path / "names.toml")


def test_broken_files_cost_what_is_in_them(tmp_path: Path) -> None:
    whole = signals("AB", 400)
    for i in range(4):
        part = {name: values[100 * i :][:100] for name, values in whole.items()}
        write(tmp_path / f"{i}.parquet", {"time": stamps(100 * i, 100), **part})
    cut = tmp_path / "2.parquet"
    cut.write_bytes(cut.read_bytes()[:2000])
    lines = [f"{10 * i},50,{50 + i % 7},{i % 5},1,2,{i % 3}" for i in range(200)]
    lines[150] = lines[150].replace(",1,2,", ",1,rubbish,")
    (tmp_path / "text.csv").write_text("t,C.SP,C.PV,C.OP,D.SP,D.PV,D.OP\n" + "\n".join(lines), encoding="utf-8")
    found = catalogue(files_of([tmp_path]), FORM)
    rows = read(found)

    assert [path.name for path, _ in found.refused] == ["2.parquet"]
    assert rows["A"]["screen"]["samples"] == 300
    assert "failed" not in rows["C"]
    assert "rubbish" in str(rows["D"]["failed"])


def test_a_file_that_breaks_after_the_catalogue_is_left_out_and_told(tmp_path: Path) -> None:
    whole = signals("A", 300)
    for i in range(3):
        part = {name: values[100 * i :][:100] for name, values in whole.items()}
        write(tmp_path / f"{i}.parquet", {"time": stamps(100 * i, 100), **part})
    found = catalogue(files_of([tmp_path]), FORM)
    (tmp_path / "1.parquet").write_bytes(b"PAR1 no more")
    row = read(found)["A"]

    assert row["screen"]["samples"] == 200
    assert any("left out" in str(told) for told in row["assumed"])
