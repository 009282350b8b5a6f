"""Recordings: what is read, and that everything malformed ends in one line that says where."""

import os
from pathlib import Path

import numpy as np
import pytest
from effort import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from retuner.drivers.recorded.recording import (
    Recording,
    RecordingError,
    read_recording,
    require_excitation,
    require_setpoint,
)

HEATER = Path(__file__).parent.parent / "data" / "heater" / "open_loop_step.csv"
GOOD = "t,sp,pv,co\n0,1,2,3\n1,1,2.5,3\n2.5,1,-3e-1,4\n"


def written(folder: Path, text: str | bytes, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_the_real_heater_is_read() -> None:
    record = read_recording(HEATER)

    assert record.sp is None
    assert len(record.t_s) == 571
    assert (record.t_s[1], record.pv[0], record.co[-1]) == (1.01, 299.53, 150.0)
    require_excitation(record)
    assert np.all(record.window().sp == 299.53)


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        GOOD.replace("\n", "\r\n"),
        "\ufeff" + GOOD,
        GOOD.replace(",", ";"),
        GOOD.replace(",", "\t"),
        "\n" + GOOD + "\n\n",
        GOOD.replace("0,1,2,3", ' 0 ,"1",+2.,.3e1'),
        GOOD.replace("co", "co,note").replace(",3\n", ",3,x_y\n").replace(",4\n", ',4,"nan, ok"\n'),
    ],
)
def test_usual_spellings_are_read(tmp_path: Path, text: str) -> None:
    record = read_recording(written(tmp_path, text))

    assert record.t_s.tolist() == [0.0, 1.0, 2.5]
    assert record.sp is not None
    assert record.sp.tolist() == [1.0, 1.0, 1.0]
    assert record.pv.tolist() == [2.0, 2.5, -0.3]
    assert record.co.tolist() == [3.0, 3.0, 4.0]


def test_columns_may_have_other_names(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD.replace("t,sp,pv,co", "time,set,temp,valve"))
    record = read_recording(path, {"t": "time", "sp": "set", "pv": "temp", "co": "valve"})

    assert record.pv.tolist() == [2.0, 2.5, -0.3]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r'a.csv:1: no column "t"; there is nothing'),
        ("t,sp,pv\n0,1,2\n", r':1: no column "co"; there is t, sp, pv'),
        (GOOD.replace("sp", "pv"), r':1: two columns are called "pv"'),
        (GOOD.replace("2.5,1", "2_5,1"), r":4: t = '2_5' is not a finite number"),
        (GOOD.replace("-3e-1", "nan"), r":4: pv = 'nan' is not a finite number"),
        (GOOD.replace("-3e-1", "inf"), r":4: pv = 'inf'"),
        (GOOD.replace("-3e-1", "1e400"), r":4: pv = '1e400'"),
        (GOOD.replace("-3e-1", "٣"), r":4: pv = '٣'"),
        (GOOD.replace("-3e-1", "0x10"), r":4: pv = '0x10'"),
        (GOOD.replace("-3e-1", "bad"), r":4: pv = 'bad'"),
        (GOOD.replace("-3e-1", ""), r":4: pv = '' is empty"),
        (GOOD.replace(",", ";").replace("2.5;1", "2,5;1"), r":4: t = '2,5' has a decimal comma"),
        ("t,pv,co\n0,0,1,0,2,0\n", r":2: 6 fields, the header has 3; a decimal comma needs ;"),
        (GOOD.replace("1,1,2.5,3", "1,1,2.5"), r":3: 3 fields, the header has 4"),
        (GOOD.replace("2.5,1", "0.5,1"), r":4: t = 0.5 follows 1; time must increase"),
        (GOOD.replace("2.5,1", "1,1"), r":4: t = 1 follows 1; time must increase"),
        (GOOD.replace("1,1,2.5", '1,"1,2.5'), r":3: quoting: "),
        (GOOD.encode() + b"3,1,2,\x00\n", r":5: a NUL byte"),
        (GOOD.encode() + b"\xff\xfe", r"not UTF-8 text"),
        ("t,sp,pv,co\n0,1,2,3\n", r"needs at least 3 samples, this one has 1"),
    ],
)
def test_malformed_text_is_refused_in_one_line_with_its_place(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(written(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert "a.csv" in str(caught.value)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path, Path("/dev/zero"), Path("a\0b")):
        with pytest.raises(RecordingError, match=r"no such file|cannot be read"):
            read_recording(path)
    os.mkfifo(tmp_path / "fifo.csv")
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path / "fifo.csv")


def test_what_is_no_file_is_named_once(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as told:
        read_recording(tmp_path / "none.csv")
    assert str(told.value).count("none.csv") == 1


@pytest.mark.parametrize("column", ["t", "pv", "co"])
def test_numbers_whose_squares_overflow_are_refused(tmp_path: Path, column: str) -> None:
    path = tmp_path / "huge.csv"
    rows = ({"t": 1.0 * i, "pv": 0.5 * i, "co": 2.0 * i} for i in range(5))
    lines = [",".join(str(v * (1e200 if name == column else 1)) for name, v in row.items()) for row in rows]
    path.write_text("t,pv,co\n" + "\n".join(lines), encoding="utf-8")
    with pytest.raises(RecordingError, match=rf"sample 2: {column}(_s)? = .*e\+\d+ is beyond 1e\+30"):
        read_recording(path)


def test_roles_and_columns_that_do_not_exist_are_named(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    with pytest.raises(RecordingError, match='no role "mv"'):
        read_recording(path, {"mv": "co"})
    with pytest.raises(RecordingError, match='no column "set"; there is t, sp, pv, co'):
        read_recording(path, {"sp": "set"})


def test_dead_signals_and_missing_setpoints_are_refused_where_it_matters() -> None:
    t = np.arange(5.0)
    moving, still = np.array([1.0, 2.0, 1.0, 2.0, 3.0]), np.full(5, 3.503246e-44)
    for record, name in ((Recording("r", t, still, moving), "pv"), (Recording("r", t, moving, still), "co")):
        with pytest.raises(RecordingError, match=f"r: {name} is 3.50325e-44 in all 5 samples"):
            require_excitation(record)
    with pytest.raises(RecordingError, match='no column "sp"'):
        require_setpoint(Recording("r", t, moving, moving))
    require_setpoint(Recording("r", t, moving, moving, moving))


@pytest.mark.filterwarnings("default")  # pyarrow's own deprecations are not ours
def test_parquet_is_the_same_as_text(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow", reason="the extra [parquet] is not installed")
    pq = pytest.importorskip("pyarrow.parquet")
    text = read_recording(HEATER)
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t": text.t_s, "pv": text.pv.astype(np.float32), "co": text.co.astype(int)}), path)
    got = read_recording(path)

    assert np.array_equal(got.t_s, text.t_s)
    assert np.array_equal(got.co, text.co)
    np.testing.assert_allclose(got.pv, text.pv, rtol=1e-7)
    for bad in (None, float("nan"), "x", True):
        pq.write_table(pa.table({"t": [0.0, 1.0, 2.0], "pv": [bad, bad, bad], "co": [0, 1, 2]}), path)
        with pytest.raises(RecordingError, match=r"row 1: pv = .* is not a finite number"):
            read_recording(path)
    path.write_bytes(b"PAR1 garbage")
    with pytest.raises(RecordingError, match="not a Parquet file"):
        read_recording(path)


NUMBERS = st.lists(st.floats(-1e6, 1e6).map(repr), min_size=12, max_size=12)


@given(data=st.data(), values=NUMBERS)
@settings(max_examples=examples(400), suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
def test_any_mutation_is_a_record_or_one_line(tmp_path: Path, data: st.DataObject, values: list[str]) -> None:
    text = "t,pv,co\n" + "".join(f"{i},{values[2 * i]},{values[2 * i + 1]}\n" for i in range(6))
    raw = bytearray(text.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(raw) - 1))
        raw[place : place + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=2))
    path = written(tmp_path, bytes(raw))
    outcome = _read(path)
    if isinstance(outcome, str):
        assert "\n" not in outcome
        assert str(path) in outcome
        return
    assert np.isfinite(outcome.pv).all()
    assert (np.diff(outcome.t_s) > 0).all()


def _read(path: Path) -> Recording | str:
    try:
        return read_recording(path)
    except RecordingError as error:
        return str(error)
