"""Exports that are no table of rows: annotated CSV of InfluxDB, pairs of time and value, units beside the values."""

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from retuner.drivers.historian.assumption import in_a_line
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.historian.record_form import RecordForm
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
