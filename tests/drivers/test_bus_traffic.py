"""Bus traffic as records: every kind of signal as cantools decodes it; loops, damage and names as in tables."""

from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from command_line import printed
from plain_recording import read_recording

from retuner.cli import main
from retuner.drivers.historian.bus_traffic import tables_of_traffic, traffic_names
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.historian.record_form import RecordForm, form_from_toml
from retuner.drivers.recorded.recording import RecordingError

VALVE = Path(__file__).parent.parent / "data" / "plant" / "FIC20102_1016_12.csv"
DBC = """VERSION ""
BU_: N
BO_ 257 FIC101: 8 N
 SG_ PV : 0|32@1- (0.001,0) [0|0] "" N
 SG_ CO : 32|32@1- (0.001,0) [0|0] "" N
BO_ 258 Setpoints: 4 N
 SG_ FIC101_SP : 0|32@1- (0.001,0) [0|0] "" N
BO_ 2147484200 Odd: 8 N
 SG_ A_PV : 7|12@0- (0.5,3) [0|0] "" N
 SG_ A_CO : 8|3@1+ (1,-2) [0|0] "" N
 SG_ A_SP : 31|32@0- (1,0) [0|0] "" N
BO_ 300 Pages: 6 N
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" N
 SG_ B_PV m0 : 8|16@1- (1,0) [0|0] "" N
 SG_ B_CO m1 : 15|16@0- (1,0) [0|0] "" N
 SG_ Other m1 : 32|8@1- (1,0) [0|0] "" N
SIG_VALTYPE_ 2147484200 A_SP : 1;
"""
RNG = np.random.default_rng(7)


@pytest.fixture
def form(tmp_path: Path) -> RecordForm:
    (tmp_path / "plant.dbc").write_text(DBC, encoding="ascii")
    return RecordForm(dbc=(str(tmp_path / "plant.dbc"),))


def log(path: Path, frames: list[tuple[float, int, bytes]]) -> Path:
    with can.Logger(str(path)) as logger:
        for t_s, identifier, data in frames:
            logger.on_message_received(
                can.Message(timestamp=t_s, arbitration_id=identifier, data=data, is_extended_id=identifier == 552)
            )
    return path


def loop(path: Path, begin_s: float = 1_700_000_000.0) -> Path:
    database = cantools.database.load_string(DBC, "dbc")
    record = read_recording(VALVE)
    assert record.sp is not None
    frames = []
    for t, sp, pv, co in zip(record.t_s, record.sp, record.pv, record.co, strict=True):
        frames.append((begin_s + t - 0.5, 258, database.encode_message("Setpoints", {"FIC101_SP": sp})))
        frames.append((begin_s + t, 257, database.encode_message("FIC101", {"PV": pv, "CO": co})))
    return log(path, frames)


def test_signals_are_what_cantools_decodes(tmp_path: Path, form: RecordForm) -> None:
    database = cantools.database.load_string(DBC, "dbc")
    frames = []
    for i in range(200):
        key = int(RNG.choice([552, 300]))
        data = bytes(RNG.integers(0, 256, 8 if key == 552 else 6, dtype=np.uint8))
        frames.append((float(i), key, bytes([i % 3]) + data[1:] if key == 300 else data))
    frames.append((200.0, 300, b"\0\1"))  # too short for its signal
    expected: dict[str, list[float]] = {}
    for _, key, data in frames[:-1]:
        if key == 552 or data[0] < 2:
            for name, value in database.get_message_by_name("Odd" if key == 552 else "Pages").decode(data).items():
                expected.setdefault(name, []).append(float(value))
    tables = tables_of_traffic(log(tmp_path / "x.blf", frames), form)

    assert [table.names[1] for table in tables if table.names[1].startswith("A_")] == ["A_PV", "A_CO", "A_SP"]
    assert len(tables) == 5
    for table in tables:
        np.testing.assert_array_equal(np.asarray(table.columns[1]), expected[table.names[1]])


@pytest.mark.parametrize("suffix", ["blf", "asc", "log"])
def test_a_loop_on_the_bus_is_read_like_its_table(tmp_path: Path, form: RecordForm, suffix: str) -> None:
    path = loop(tmp_path / f"x.{suffix}")
    read, table = read_loop_record([path], form).recording, read_recording(VALVE)

    assert traffic_names(path, form) == ["FIC101_SP", "FIC101.PV", "FIC101.CO"]
    np.testing.assert_allclose(read.t_s - read.t_s[0], table.t_s, atol=1e-3)
    np.testing.assert_allclose(read.pv, table.pv, atol=6e-4)
    np.testing.assert_allclose(read.co, table.co, atol=6e-4)
    assert read.sp is not None
    np.testing.assert_allclose(read.sp, table.sp if table.sp is not None else np.nan, atol=6e-4)


def test_a_log_that_ends_in_damage_is_taken_as_far_as_it_goes(tmp_path: Path, form: RecordForm) -> None:
    path = loop(tmp_path / "x.asc")
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: len(text) // 2] + "\n 12.5 1 zz Rx d 8 rubbish\n", encoding="utf-8")
    record = read_loop_record([path], form)

    assert 300 < len(record.recording.t_s) < 451
    assert any("what stands before it was taken" in a.what for a in record.assumed)


def test_a_log_without_a_dbc_or_with_a_foreign_one_is_told(tmp_path: Path) -> None:
    path = loop(tmp_path / "x.blf")
    with pytest.raises(RecordingError, match=r"give the file with --dbc"):
        read_loop_record([path])
    (tmp_path / "other.dbc").write_text(DBC.replace("257", "511").replace("258", "512"), encoding="ascii")
    with pytest.raises(RecordingError, match="none of its frames"):
        read_loop_record([path], RecordForm(dbc=(str(tmp_path / "other.dbc"),)))
    (tmp_path / "broken.dbc").write_text("no DBC", encoding="ascii")
    with pytest.raises(RecordingError, match=r"broken\.dbc"):
        read_loop_record([path], RecordForm(dbc=(str(tmp_path / "broken.dbc"),)))


def test_an_audit_takes_logs_and_tables_of_one_folder(tmp_path, form, capsys):
    folder, out = tmp_path / "plant", tmp_path / "out"
    folder.mkdir()
    loop(folder / "bus.blf")
    (folder / "calm.csv").write_text("t,sp,pv,co\n" + "".join(f"{i},5,5,{i % 2}\n" for i in range(50)), "utf-8")
    (tmp_path / "record.toml").write_text(f'[record]\ndbc = ["{form.dbc[0]}"]\n', encoding="utf-8")
    assert form_from_toml(tmp_path / "record.toml").dbc == form.dbc
    arguments = ["audit", str(folder), "--out", str(out), "--jobs", "1", "--stretches", "1"]
    assert "FIC101: repair the valve" in printed(*arguments, "--dbc", form.dbc[0])
    assert main([*arguments]) == 0
    assert "give the file with --dbc" in capsys.readouterr().err
