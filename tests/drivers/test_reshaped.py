"""Exports that are no table of rows: annotated CSV of InfluxDB, pairs of time and value, units beside the values."""

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import can
import cantools
import numpy as np
import pandas as pd
import pytest
from command_line import printed
from hypothesis import given
from hypothesis import strategies as st
from plain_recording import read_recording

import retuner
from retuner.cli import main
from retuner.drivers.historian.assumption import in_a_line
from retuner.drivers.historian.bus_traffic import tables_of_traffic, traffic_names
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.historian.record_form import RecordForm, form_from_toml
from retuner.drivers.historian.scaling import Scaling
from retuner.drivers.recorded.recording import RecordingError

N = 40
T = np.arange(N) * 10.0
BEGIN = datetime(2024, 3, 14, 21, 55)  # noqa: DTZ001  a plant's clock has no zone
SIGNALS = {
    "PV": np.round(50 + np.sin(0.37 * np.arange(N)), 3),
    "OP": np.round(30 + 3 * np.cos(0.11 * np.arange(N)), 2),
    "SP": np.where(T < 200, 50.5, 55.0),
}
ROLES = {"PV": "pv", "OP": "co", "SP": "sp"}


def stamp(t: float) -> str:
    return f"{BEGIN + timedelta(seconds=t):%Y-%m-%dT%H:%M:%SZ}"


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], Path]:
    def write(content: str) -> Path:
        path = tmp_path / "a.csv"
        path.write_text(content, encoding="utf-8")
        return path

    return write


def is_the_loop(path: object, form: RecordForm | None = None) -> str:
    found = read_loop_record([path], form or RecordForm())
    np.testing.assert_allclose(found.recording.t_s, T, atol=1e-3)
    for name, role in ROLES.items():
        assert np.array_equal(getattr(found.recording, role), SIGNALS[name]), role
    return in_a_line(found.assumed)


HEAD = """#group,false,false,true,true,false,false,true,true
#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string
#default,mean,,,,,,,
,result,table,_start,_stop,_time,_value,_field,_measurement
"""


def series(measurement: str, field: str, values: np.ndarray, table: int = 0) -> str:
    ends = f"{stamp(0)},{stamp(9999)}"
    rows = [f",,{table},{ends},{stamp(t)},{v},{field},{measurement}" for t, v in zip(T, values, strict=True)]
    return "\n".join(rows) + "\n"


def test_annotated_tables_of_influx_one_after_the_other_with_heads_of_their_own(written: Callable[[str], Path]) -> None:
    content = "\n".join(HEAD + series("FIC101", name, values) for name, values in SIGNALS.items())

    assert "annotated CSV of InfluxDB" in is_the_loop(written(content))


def test_series_of_influx_are_told_apart_by_what_differs(written: Callable[[str], Path]) -> None:
    content = HEAD
    for tag in ("FIC101", "TIC7"):
        content += "".join(series(tag, n, v + (tag == "TIC7"), i) for i, (n, v) in enumerate(SIGNALS.items()))

    is_the_loop(written(content), RecordForm(tag="FIC101"))
    with pytest.raises(RecordingError, match="2 loops in it; name one with --tag: FIC101, TIC7"):
        read_loop_record([written(content)])


def test_a_pivoted_table_of_influx(written: Callable[[str], Path]) -> None:
    head = "#group,false,false,true,false,false,false,false\n"
    head += "#datatype,string,long,string,dateTime:RFC3339,double,double,double\n"
    head += "#default,_result,,,,,,\n,result,table,loop,_time,OP,PV,SP\n"
    columns = (SIGNALS["OP"], SIGNALS["PV"], SIGNALS["SP"])
    rows = [f",,0,FIC101,{stamp(t)},{a},{b},{c}" for t, a, b, c in zip(T, *columns, strict=True)]

    is_the_loop(written(head + "\n".join(rows)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("#group,false\n#datatype,string\n", "has annotations but no values"),
        ("#datatype,long\n,table,_value\n,0,1\n", ":2: a table without _time"),
        (HEAD + ",,0,1\n", ":5: 4 fields, the head of its table has 9"),
    ],
)
def test_annotated_text_that_is_none_is_refused_in_one_line(written, content, message):
    with pytest.raises(RecordingError) as refused:
        read_loop_record([written(content)])
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def pairs(header: str, form: str = "%d-%b-%y %H:%M:%S", late: int = 0) -> str:
    """Time, value, ...; the last signal has `late` rows less: its columns end blank."""
    rows = []
    for i, t in enumerate(T):
        when = (BEGIN + timedelta(seconds=t)).strftime(form)
        cells = [f"{when},{values[i]}" for values in SIGNALS.values()]
        if i >= N - late:
            cells[-1] = ","
        rows.append(",".join(cells))
    return header + "\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize("header", ["Time,FIC101.PV,Time,FIC101.OP,Time,FIC101.SP", "FIC101.PV,,FIC101.OP,,FIC101.SP,"])
def test_pairs_of_time_and_value(written: Callable[[str], Path], header: str) -> None:
    assert "3 signals with times of their own, side by side" in is_the_loop(written(pairs(header)))


def test_pairs_of_a_frame_and_in_seconds(written: Callable[[str], Path]) -> None:
    stamps = pd.to_datetime(BEGIN) + pd.to_timedelta(T, unit="s")
    columns = [c for name, v in SIGNALS.items() for c in ((f"t {name}", stamps), (f"FIC101.{name}", v))]
    is_the_loop(pd.DataFrame(dict(columns)))

    rows = "\n".join(",".join(f"{t},{v[i]}" for v in SIGNALS.values()) for i, t in enumerate(T))
    is_the_loop(written(f"time,A.PV,time,A.OP,time,A.SP\n{rows}\n"))


def test_a_signal_of_a_pair_that_is_stored_by_exception_is_held(written: Callable[[str], Path]) -> None:
    seldom = [f"{stamp(t)},{v},{stamp(3 * t)},{30 + i}" for i, (t, v) in enumerate(zip(T, SIGNALS["PV"], strict=True))]
    found = read_loop_record([written("\n".join(["Time,A.PV,Time,A.OP", *seldom]))])

    assert found.recording.co[:7].tolist() == [30, 30, 30, 31, 31, 31, 32]


def test_pairs_without_a_name_are_refused(written: Callable[[str], Path]) -> None:
    with pytest.raises(RecordingError, match="a time and a value without a name"):
        read_loop_record([written(pairs("Time,Value,Time,Value,Time,Value"))])


@pytest.mark.parametrize(("unit", "decimal"), [(" °C", "."), ("°C", ","), (" bar", ","), (" m³/h", "."), ("%", ".")])
def test_a_unit_beside_each_value_is_taken_off_and_told(written, unit, decimal):
    def cell(value: float, its: str) -> str:
        return f"{value}".replace(".", decimal) + its

    rows = [
        ";".join([f"{t:.0f}", cell(sp, unit), cell(pv, unit), cell(co, " %")])
        for t, sp, pv, co in zip(T, SIGNALS["SP"], SIGNALS["PV"], SIGNALS["OP"], strict=True)
    ]
    told = is_the_loop(written("\n".join(["t;sp;pv;co", *rows])))

    assert (f"pv in {unit.strip()}, as its values say" in told) == (unit != "%")


@pytest.mark.parametrize(("other", "message"), [(" °F", "°F, and °C in line 2"), ("", "no unit, and °C in line 2")])
def test_values_in_several_units_are_refused(written: Callable[[str], Path], other: str, message: str) -> None:
    rows = [f"{t:.0f};50;{v}{other if t == 100 else ' °C'};30" for t, v in zip(T, SIGNALS["PV"], strict=True)]

    with pytest.raises(RecordingError, match=message):
        read_loop_record([written("\n".join(["t;sp;pv;co", *rows]))])


def test_names_that_begin_with_digits_are_no_values_with_a_unit(written: Callable[[str], Path]) -> None:
    rows = [f"{t:.0f},{a},{b},{c}" for t, a, b, c in zip(T, SIGNALS["SP"], SIGNALS["PV"], SIGNALS["OP"], strict=True)]

    told = is_the_loop(written("\n".join(["t,2411FIC20102.SV,2411FIC20102.PV,2411FIC20102.MV", *rows])))
    assert 'pv is "2411FIC20102.PV"' in told


# Raw signals, 4 to 20 mA and counts, come out in the unit of the plant; what is no scaling is refused.


ENDS = st.floats(-1e6, 1e6)


@given(ENDS, ENDS, ENDS, ENDS, st.floats(-1e6, 1e6))
def test_there_and_back(raw_low: float, raw_high: float, low: float, high: float, value: float) -> None:
    if abs(raw_low - raw_high) < 1e-3 or abs(low - high) < 1e-3:
        return
    there, back = Scaling(raw_low, raw_high, low, high), Scaling(low, high, raw_low, raw_high)
    size = max(map(abs, (raw_low, raw_high, value)))
    steep = max(abs(raw_high - raw_low) / abs(high - low), abs(high - low) / abs(raw_high - raw_low), 1.0)
    room = 1e-9 * steep * max(size, abs(there.applied(value)), abs(low))
    assert back.applied(there.applied(value)) == pytest.approx(value, abs=room)
    again = Scaling.of(there.text())
    assert again.applied(value) == pytest.approx(there.applied(value), abs=room)


@pytest.mark.parametrize(
    ("text", "raw", "meant"),
    [
        ("4..20:0..200", 12.0, 100.0),
        ("mA:0..200", 3.8, -2.5),
        ("0..27648:-50..150", 13824.0, 50.0),
        ("V:100..0", 2.5, 75.0),
    ],
)
def test_known_values(text: str, raw: float, meant: float) -> None:
    assert Scaling.of(text).applied(raw) == pytest.approx(meant)
    assert Scaling.of(text).of_all(np.array([raw]))[0] == pytest.approx(meant)


@pytest.mark.parametrize(
    "text", ["", "4-20", "4..20", "4..20:0", "4..4:0..1", "4..20:5..5", "nan..1:0..1", "1e999..2:0..1"]
)
def test_what_is_no_scaling_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"give|same"):
        RecordForm(scale={"pv": text})
    with pytest.raises(ValueError, match="signals are"):
        RecordForm(scale={"x": "4..20:0..1"})


def frame(sp: list[float]) -> pd.DataFrame:
    return pd.DataFrame({"t": [0.0, 1.0, 2.0], "PV": [4.0, 12.0, 20.0], "OP": [4.0, 4.0, 12.0], "SP": sp})


def test_a_record_in_milliamperes_is_read_in_units_of_the_plant(tmp_path: Path) -> None:
    scale = {"pv": "mA:0..200", "co": "4..20:0..100"}
    read = retuner.read(frame([12.0, 12.0, 12.0]), scale=scale)
    assert read.recording.pv.tolist() == [0.0, 100.0, 200.0]
    assert read.recording.co.tolist() == [0.0, 0.0, 50.0]
    assert read.recording.sp.tolist() == [100.0] * 3
    assert "sp is recorded like pv" in " ".join(one.what for one in read.assumed)
    plain = retuner.read(frame([100.0, 100.0, 100.0]), scale=scale)
    assert plain.recording.sp.tolist() == [100.0] * 3
    assert "sp is in the unit of pv already" in " ".join(one.what for one in plain.assumed)
    file = tmp_path / "form.toml"
    file.write_text('[record]\nscale = { pv = "4..20:0..200" }\n')
    assert form_from_toml(file).scale == {"pv": "4..20:0..200"}
    file.write_text("[record]\nscale = { pv = 3 }\n")
    with pytest.raises(RecordingError, match="ranges by signal"):
        form_from_toml(file)


# Bus traffic as records: every kind of signal as cantools decodes it; loops, damage and names as in tables.


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
