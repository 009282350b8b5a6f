"""Records as plants export them: what is found is right, what was assumed is told, what is ambiguous is asked."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_recording import read_recording

from retuner.drivers.historian.assumption import in_a_line, in_full, quoted
from retuner.drivers.historian.loop_record import LoopRecord, read_loop_record
from retuner.drivers.historian.record_form import RecordForm, form_from_toml
from retuner.drivers.historian.row_order import in_order
from retuner.drivers.historian.tags import loops, named
from retuner.drivers.recorded.recording import RecordingError

DATA = Path(__file__).parent.parent / "data"
N = 60
T = np.arange(N) * 10.0
SP = np.where(T < 200, 50.5, 55.0)
PV = np.round(50 + np.sin(0.37 * np.arange(N)), 3)
CO = np.round(30 + 3 * np.cos(0.11 * np.arange(N)), 2)
BEGIN = datetime(2024, 3, 14, 21, 55)  # noqa: DTZ001  a plant's clock has no zone
LATE = datetime(2024, 1, 31, 23, 55)  # noqa: DTZ001  goes on into the next month

Cells = Sequence[object] | np.ndarray


def stamps(form: str, begin: datetime = BEGIN) -> list[str]:
    return [(begin + timedelta(seconds=float(t))).strftime(form) for t in T]


def comma(values: Iterable[float]) -> list[str]:
    return [str(value).replace(".", ",") for value in values]


def text(header: str, *columns: Cells, sep: str = ",") -> str:
    rows = "\n".join(sep.join(str(column[i]) for column in columns) for i in range(len(columns[0])))
    return f"{header}\n{rows}\n" if header else rows + "\n"


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    def write(content: str, name: str = "a.csv", encoding: str = "utf-8") -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode(encoding))
        return path

    return write


def is_the_loop(read: LoopRecord, *, with_sp: bool = True) -> None:
    record = read.recording
    np.testing.assert_allclose(record.t_s, T, atol=1e-3)
    assert np.array_equal(record.pv, PV)
    assert np.array_equal(record.co, CO)
    assert (record.sp is not None) == with_sp
    if record.sp is not None:
        assert np.array_equal(record.sp, SP)


EPOCH = [BEGIN.replace(tzinfo=UTC).timestamp() + t for t in T]
US = "Timestamp,FIC101.SP,FIC101.PV,FIC101.OP"
FORMS = {
    "plain": (text("t,sp,pv,co", T, SP, PV, CO), ""),
    "quoted": (text('"t","sp","pv","co"', *([f'"{v}"' for v in c] for c in (T, SP, PV, CO))), ""),
    "trailing delimiter": (text("t;sp;pv;co", T, SP, PV, [f"{v};" for v in CO], sep=";"), ""),
    "spaces": (text("t  sp  pv  co", T, SP, PV, CO, sep="   "), ""),
    "a comment as header": (text("# of the pilot plant\n# t sp pv co", T, SP, PV, CO, sep=" "), ""),
    "German": (
        text("Zeit;Sollwert;Istwert;Stellwert", stamps("%d.%m.%Y %H:%M:%S"), *map(comma, (SP, PV, CO)), sep=";"),
        "decimal comma; time as %d.%m.%Y",
    ),
    "German with an umlaut": (
        text("Zeit;Sollwert;Istwert;Stellgröße", *map(comma, (T, SP, PV, CO)), sep=";"),
        'co is "Stellgröße"',
    ),
    "American": (text(US, stamps("%m/%d/%Y %I:%M:%S %p"), SP, PV, CO), "time as %m/%d/%Y"),
    "date and time apart": (
        text("Date,Time,SP,PV,OP", stamps("%d/%m/%Y"), stamps("%H:%M:%S"), SP, PV, CO),
        "time as %d/%m/%Y",
    ),
    "told by the month": (text("Time,SP,PV,OP", stamps("%d/%m/%Y %H:%M:%S", LATE), SP, PV, CO), "time as %d/%m/%Y"),
    "month by its name": (text(US, stamps("%d-%b-%y %H:%M:%S.000"), SP, PV, CO), "time as %d-%b-%y"),
    "Niagara": (text(US, stamps("%d-%b-%y %I:%M:%S %p CDT"), SP, PV, CO), "CDT as UTC-5 h"),
    "K-Spice": (
        text("Tag-names\t\tF1:Measurement\t\tF1:InternalSetpoint\t\tF1:ControllerOutput", T, PV, SP, CO, sep="\t\t"),
        'sp is "F1:InternalSetpoint"',
    ),
    "ISO with zone": (text(US, stamps("%Y-%m-%dT%H:%M:%SZ"), SP, PV, CO), "time as %Y-%m-%d"),
    "epoch": (text("time,sp,pv,co", EPOCH, SP, PV, CO), "from 1970 in s"),
    "epoch in ms": (text("time,sp,pv,co", [int(1000 * t) for t in EPOCH], SP, PV, CO), "from 1970 in ms"),
    "days of a spreadsheet": (text("time,sp,pv,co", 45000 + T / 86400, SP, PV, CO), "days of a spreadsheet"),
    "digits": (text("time,sp,pv,co", stamps("%Y%m%d%H%M%S"), SP, PV, CO), "digits of date and time"),
    "hours": (text("time [h],sp,pv,co", T / 3600, SP, PV, CO), ""),
    "minutes": (text("time_min,sp,pv,co", T / 60, SP, PV, CO), ""),
    "newest first": (
        text("time,sp,pv,co", stamps("%Y-%m-%d %H:%M:%S")[::-1], SP[::-1], PV[::-1], CO[::-1]),
        "newest first",
    ),
    "units row": (text("time,SP,PV,OP\ns,degC,degC,%", T, SP, PV, CO), 'time "time" in s, of the row of units'),
    "preamble": (
        "Export of plant X\nby operator, at 10:00\n\n" + text(US, stamps("%Y-%m-%d %H:%M:%S"), SP, PV, CO),
        'pv is "FIC101.PV"',
    ),
    "stamps of a minute": (text("time,sp,pv,co", stamps("%Y-%m-%d %H:%M"), SP, PV, CO), "6 rows to a stamp"),
    "cut in a row": (text("t,sp,pv,co", T, SP, PV, CO) + "600,5", "last line is cut"),
    "manipulated variable": (text("t,F1.SV,F1.PV,F1.MV", T, SP, PV, CO), 'co is "F1.MV"'),
    "measured value": (text("t,F1.SP,F1.MV,F1.OP", T, SP, PV, CO), 'pv is "F1.MV"'),
    "further columns": (text("t,sp,pv,co,note", T, SP, PV, CO, ["all, well".replace(",", "")] * N), ""),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_found_and_told(written: Callable[..., Path], name: str) -> None:
    content, told = FORMS[name]
    read = read_loop_record([written(content)])

    is_the_loop(read)
    if told:
        assert told in in_a_line(read.assumed)
    else:
        assert read.assumed == ()


@pytest.mark.parametrize(
    ("encoding", "told"), [("utf-8-sig", ""), ("latin-1", "Latin-1"), ("utf-16", "UTF-16"), ("utf-16-le", "UTF-16")]
)
def test_encodings_are_found(written: Callable[..., Path], encoding: str, told: str) -> None:
    content = text("t\tsp\tpv\tco\tÖl °C", T, SP, PV, CO, T, sep="\t")
    read = read_loop_record([written(content, encoding=encoding)])

    is_the_loop(read)
    assert told in in_a_line(read.assumed)


def test_a_real_export_is_read_as_it_is() -> None:
    read = read_loop_record([DATA / "raw" / "historian_export_1.txt"])

    assert read.tag == "2411FIC20102"
    assert len(read.recording.t_s) == 751
    assert np.all(np.diff(read.recording.t_s) == 10.0)
    assert (read.recording.pv[0], read.recording.co[0]) == (99.3204336, 24.016456452)
    assert read.recording.sp[0] == 99.99994


@pytest.mark.parametrize("path", sorted(DATA.glob("*/*.csv")), ids=lambda path: path.stem)
def test_a_plain_record_is_read_as_the_strict_reader_reads_it(path: Path) -> None:
    strict, read = read_recording(path), read_loop_record([path])

    assert read.assumed == ()
    for name in ("t_s", "sp", "pv", "co"):
        assert np.array_equal(getattr(strict, name), getattr(read.recording, name))


def test_missing_values_are_left_out_and_counted(written: Callable[..., Path]) -> None:
    pv = [str(v) for v in PV]
    for row, word in ((5, "Bad"), (9, ""), (12, "[-11059] No Good Data For Calculation"), (13, "NULL"), (20, "Kaputt")):
        pv[row] = word
    path = written(text("t,sp,pv,co", T, SP, pv, CO))
    with pytest.raises(RecordingError, match=r"a.csv:22: pv = 'Kaputt' is not a number; .* give --bad"):
        read_loop_record([path])
    read = read_loop_record([path], RecordForm(bad=("kaputt",)))

    assert "5 values of pv missing" in in_a_line(read.assumed)
    assert read.recording.t_s.tolist() == [t for i, t in enumerate(T) if i not in {5, 9, 12, 13, 20}]


@pytest.mark.parametrize(("fine", "poor"), [("Good", "Bad"), ("192", "24"), ("ok", "uncertain")])
def test_values_of_bad_quality_are_left_out(written: Callable[..., Path], fine: str, poor: str) -> None:
    quality = [poor if i == 7 else fine for i in range(N)]
    read = read_loop_record([written(text("t,sp,pv,co,quality", T, SP, PV, CO, quality))])

    assert len(read.recording.t_s) == N - 1
    assert 70.0 not in read.recording.t_s
    assert "1 rows of bad quality" in in_a_line(read.assumed)


def test_a_quality_that_nobody_knows_is_asked_for(written: Callable[..., Path]) -> None:
    path = written(text("t,sp,pv,co,quality", T, SP, PV, CO, [i % 2 for i in range(N)]))
    with pytest.raises(RecordingError, match="quality quality is 0, 1; name the good value with --good"):
        read_loop_record([path])
    assert len(read_loop_record([path], RecordForm(good="1")).recording.t_s) == N // 2


def test_signals_in_files_of_their_own_are_joined(written: Callable[..., Path]) -> None:
    when = stamps("%Y-%m-%d %H:%M:%S")
    files = [
        written(text("Timestamp,Value", when, c), f"FIC7.{r}.csv") for r, c in (("PV", PV), ("OP", CO), ("SP", SP))
    ]
    read = read_loop_record(files)

    is_the_loop(read)
    assert read.tag == "FIC7"


@pytest.mark.parametrize("columns", ["duct pressure,fan speed,wanted", "static.csv,fan,static_sp"])
def test_names_that_differ_from_file_to_file_are_columns_or_files(written: Callable[..., Path], columns: str) -> None:
    when = stamps("%d-%b-%y %I:%M:%S %p CST")
    files = [
        written(text(header, when, values), f"{name}.csv")
        for name, header, values in (
            ("fan", "Timestamp,fan speed", CO), ("static", "Date,duct pressure", PV), ("static_sp", "Time,wanted", SP),
        )
    ]  # fmt: skip
    is_the_loop(
        read_loop_record(files, RecordForm(columns=dict(zip(("pv", "co", "sp"), columns.split(","), strict=True))))
    )
    with pytest.raises(RecordingError, match=r'no column and no file is called "elsewhere"; .* or a file as in --col'):
        read_loop_record(files, RecordForm(columns={"pv": "static", "co": "elsewhere"}))
    with pytest.raises(
        RecordingError, match=r'no column "pv"; .* in the files fan, static, static_sp; name a column or'
    ):
        read_loop_record(files)
    both = written(text("Timestamp,PV,OP", when, PV, CO), "both.csv")
    with pytest.raises(RecordingError, match="holds Timestamp, PV, OP; name its column"):
        read_loop_record([*files, both], RecordForm(columns={"pv": "both", "co": "fan"}))


def test_trends_of_a_building_as_niagara_writes_them_are_read() -> None:
    """Real files, of which each calls its columns as it likes; the clock goes on through the change of the zone."""
    fan, wanted = DATA / "raw" / "ahu_niagara_fan.txt", DATA / "raw" / "ahu_niagara_static_sp.txt"
    read = read_loop_record([fan, wanted], RecordForm(columns={"pv": "Value (%)", "co": "duct_static_setpoint"}))
    assert len(read.recording.t_s) == 399
    assert set(np.diff(read.recording.t_s)) == {300.0}
    assert "CDT as UTC-5 h, CST as UTC-6 h" in in_a_line(read.assumed)
    assert read.begin_s == datetime(2022, 5, 7, 17, 10, tzinfo=UTC).timestamp()


@pytest.mark.parametrize("apart", [False, True])
def test_a_state_beside_a_value_tells_whether_it_is_good(written: Callable[..., Path], apart: bool) -> None:
    """Niagara's: one in alarm is what the sensor reads; one that is down, or that a hand has set, is not."""
    states = ["{ok}"] * N
    states[5:9] = ["{down,stale}", "{alarm,unackedAlarm}", "{overridden}", "{null}"]
    when = stamps("%d-%b-%y %I:%M:%S %p CDT")
    if apart:
        files = [
            written(
                text("Timestamp,Trend Flags,Status,Value", when, ["{ }"] * N, [f'"{s}"' for s in states], values), name
            )
            for name, values in (("temp.csv", PV), ("valve.csv", CO), ("wanted.csv", SP))
        ]
        form = RecordForm(columns={"pv": "temp", "co": "valve", "sp": "wanted"})
    else:
        cells = [f'"{v} °F {s}"' for v, s in zip(PV, states, strict=True)]
        files = [written(text(US, when, [f"{v} {{ok}}" for v in SP], cells, [f"{v} % {{ok}} @ def" for v in CO]))]
        form = RecordForm()
    read = read_loop_record(files, form).recording
    kept = [i for i in range(N) if i not in {5, 7, 8}]
    assert read.t_s.tolist() == T[kept].tolist()
    assert np.array_equal(read.pv, PV[kept])
    assert np.array_equal(read.co, CO[kept])


def test_a_zone_that_is_not_known_is_asked_for(written: Callable[..., Path]) -> None:
    path = written(text(US, stamps("%d-%b-%y %I:%M:%S %p XYZ"), SP, PV, CO))
    with pytest.raises(RecordingError, match=r"PM XYZ' is of a zone that is not known; .* --zone") as told:
        read_loop_record([path])
    assert "time-format" not in str(told.value)
    read = read_loop_record([path], RecordForm(zone="Asia/Kolkata"))
    is_the_loop(read)
    assert "XYZ as Asia/Kolkata" in in_a_line(read.assumed)


def test_days_in_automatic_are_all_taken(written: Callable[..., Path]) -> None:
    mode = ["OFF" if i % 90 >= 20 else "AUTO" for i in range(200)]
    one = np.arange(200.0)
    read = read_loop_record([written(text("t,sp,pv,co,mode", one, one, one, one, mode))], in_automatic=True)
    assert len(read.recording.t_s) == 60
    assert "3 stretches in automatic taken, 60 of 200 rows" in in_a_line(read.assumed)


def test_an_output_stored_by_exception_is_held(written: Callable[..., Path]) -> None:
    moves = np.flatnonzero(np.arange(N) % 7 == 0)
    files = [written(text("t,pv", T, PV), "pv.csv"), written(text("t,co", T[moves] - 1.0, CO[moves]), "co.csv")]
    read = read_loop_record(files, RecordForm(sp=50.0))

    assert "co has rows of its own: held" in in_a_line(read.assumed)
    assert np.array_equal(read.recording.co, CO[(np.arange(N) // 7) * 7])
    assert read.recording.sp is not None
    assert np.all(read.recording.sp == 50.0)


def test_a_table_of_many_loops_asks_which(written: Callable[..., Path]) -> None:
    path = written(text("t,A.SP,A.PV,A.OP,B.SP,B.PV,B.OP", T, SP + 1, PV, CO, SP, PV, CO))
    with pytest.raises(RecordingError, match="2 loops in it; name one with --tag: A, B"):
        read_loop_record([path])
    is_the_loop(read_loop_record([path], RecordForm(tag="b")))
    with pytest.raises(RecordingError, match='no loop "C"'):
        read_loop_record([path], RecordForm(tag="C"))


def test_a_long_table_has_a_row_for_each_value(written: Callable[..., Path]) -> None:
    when = stamps("%Y-%m-%d %H:%M:%S")
    rows = [f"F1.{r},{when[i]},{c[i]},Good" for i in range(N) for r, c in (("PV", PV), ("SP", SP), ("OP", CO))]
    read = read_loop_record([written("Tag,Timestamp,Value,Quality\n" + "\n".join(rows))])

    is_the_loop(read)
    assert read.tag == "F1"


def test_a_record_in_pieces_is_put_together(tmp_path: Path, written: Callable[..., Path]) -> None:
    for i, part in enumerate((slice(40, N), slice(0, 40))):
        written(text("t,sp,pv,co", T[part], SP[part], PV[part], CO[part]), f"day{i}.csv")
    is_the_loop(read_loop_record([tmp_path]))
    written(text("t,sp,pv,co", T[:3], SP[:3], PV[:3], CO[:3]), "again.csv")
    with pytest.raises(RecordingError, match="has two values at the same time"):
        read_loop_record([tmp_path])


def test_only_the_longest_stretch_in_automatic_is_taken_where_that_is_asked(written: Callable[..., Path]) -> None:
    mode = ["MAN" if i < 10 or i == 20 else "AUTO" for i in range(N)]
    path = written(text("t,sp,pv,co,mode", T, SP, PV, CO, mode))
    read = read_loop_record([path], in_automatic=True)

    assert np.array_equal(read.recording.t_s, T[21:])
    assert f"{N - 21} of {N} rows" in in_a_line(read.assumed)
    assert len(read_loop_record([path]).recording.t_s) == N


CLOCK_BACK = "time,sp,pv,co\n" + "".join(
    f"2024-10-27 0{h}:{m:02d}:00,1,{h + m},{m}\n" for h, m in [(1, 30), (2, 0), (2, 30), (2, 0), (2, 30), (3, 0)]
)


def test_the_hour_that_comes_twice_needs_the_zone(written: Callable[..., Path]) -> None:
    path = written(CLOCK_BACK)
    with pytest.raises(RecordingError, match="clock goes back by one hour; give --zone"):
        read_loop_record([path])
    read = read_loop_record([path], RecordForm(zone="Europe/Berlin"))

    assert np.all(np.diff(read.recording.t_s) == 1800.0)


def test_a_row_that_comes_late_or_a_clock_that_is_set_right_is_no_hour_that_comes_twice(
    written: Callable[..., Path],
) -> None:
    seconds = [*range(0, 1000, 5), 985, *range(1000, 2000, 5)]
    rows = "".join(f"2024-10-24 10:{s // 60:02d}:{s % 60:02d},1,{s},{s}\n" for s in seconds)
    assert "out of order" in in_a_line(read_loop_record([written("time,sp,pv,co\n" + rows)]).assumed)


@pytest.mark.parametrize(
    ("content", "form", "message"),
    [
        ("", RecordForm(), "is empty"),
        ("hello world\nthis is, no table\n", RecordForm(), "no row of numbers"),
        (text("", T, SP, PV, CO), RecordForm(), 'no column "pv"; there is 1, 2, 3, 4; name it as in --columns pv=NAME'),
        (text("sp,pv,co", SP, PV, CO), RecordForm(), 'no column "t".* or give --dt'),
        (text("t,sp,pv", T, SP, PV), RecordForm(), 'no column "co"'),
        (text("t,pv,pv,co", T, SP, PV, CO), RecordForm(), 'two columns are called "pv"'),
        (text("t,pv,co", [1, 2, 3, 4] * 15, PV, CO), RecordForm(), "sample 5: t = 1 follows 4; time must increase"),
        (text("t;pv;co", T, ["1,100"] * N, ["7"] * N, sep=";"), RecordForm(), "may separate thousands or decimals"),
        (text("t;pv;co", T, comma(PV), CO, sep=";"), RecordForm(), "has a decimal comma, others a point"),
        (text("t,pv,co", T, PV, CO).replace("10.0,", "10.0,1,"), RecordForm(), ":3: 4 fields, other rows have 3"),
        (text("t,pv,co", T, PV, CO), RecordForm(columns={"pv": "x"}), 'no column "x"; there is t, pv, co'),
        (text("t,pv,co", ["some day"] * N, PV, CO), RecordForm(), "has an unknown format; give --time-format"),
        (text("t,pv,co", stamps("%H:%M"), PV, CO), RecordForm(time_format="%H.%M"), "is not of the form %H.%M"),
    ],
)
def test_what_is_no_record_or_may_be_two_is_refused_in_one_line(written, content, form, message):
    with pytest.raises(RecordingError, match=message) as told:
        read_loop_record([written(content)], form)
    assert "\n" not in str(told.value)
    assert "a.csv" in str(told.value)


def test_a_day_that_may_be_a_month_is_asked_for_only_where_it_matters(written: Callable[..., Path]) -> None:
    rare = [f"{i % 12 + 1:02d}/{i % 2 + 1:02d}/{2000 + i // 12} 00:00:00" for i in range(N)]
    asked = written(text("Time,SP,PV,OP", rare, SP, PV, CO))
    with pytest.raises(RecordingError, match=r'may be %d/%m/%Y or %m/%d/%Y; give --time-format "%d/%m/%Y %H:%M:%S"'):
        read_loop_record([asked])
    for hour, minute in ((12, 0), (23, 55)):  # a month would be left out at midnight
        begin = BEGIN.replace(day=4, hour=hour, minute=minute)
        for form in ("%d/%m/%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p"):
            is_the_loop(read_loop_record([written(text("Time,SP,PV,OP", stamps(form, begin), SP, PV, CO))]))


def test_a_table_that_was_written_twice_is_read_once(written: Callable[..., Path]) -> None:
    read = read_loop_record([written(text("t,sp,pv,co", *(np.repeat(x, 2) for x in (T, SP, PV, CO))))])
    is_the_loop(read)
    assert in_a_line(read.assumed) == "60 rows that repeat the row before: left out"
    finer = [*PV[:-1], PV[-1] + 0.1]  # two samples to a stamp
    fast = read_loop_record(
        [written(text("t,sp,pv,co", np.repeat(T[: N // 2], 2), SP, np.repeat(finer[::2], 2), finer))]
    )
    assert "2 rows to a stamp" in in_a_line(fast.assumed)


def test_times_of_day_without_a_date_go_on_after_midnight(written: Callable[..., Path]) -> None:
    path = written(text("time,SP,PV,OP", stamps("%H:%M:%S"), SP, PV, CO))
    is_the_loop(read_loop_record([path]))
    is_the_loop(read_loop_record([path], RecordForm(time_format="%H:%M:%S")))
    back = written(text("ts,SP,PV,OP", stamps("%I:%M:%S %p")[::-1], SP[::-1], PV[::-1], CO[::-1]))
    is_the_loop(read_loop_record([back]))


def test_what_was_assumed_can_be_fixed_by_its_own_words(tmp_path: Path, written: Callable[..., Path]) -> None:
    for name, (content, _) in FORMS.items():
        path = written(content)
        read = read_loop_record([path])
        kept = tmp_path / "form.toml"
        kept.write_text("\n".join(in_full(read.assumed)) + "\n", encoding="utf-8")
        again = read_loop_record([path], form_from_toml(kept))
        assert np.array_equal(again.recording.t_s, read.recording.t_s), name
        assert np.array_equal(again.recording.pv, read.recording.pv), name


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[other]\n", r"no section \[record\]"),
        ("[record]\nspan = 3\n", r"\[record\] span: no such key"),
        ('[record]\nsp = "50"\n', r"\[record\] sp = '50': give a number"),
        ('[record]\nsp = { sp = "50" }\n', r"\[record\] sp = {'sp': '50'}: give a number"),
        ("[record]\ndt_s = -1\n", r"\[record\] dt_s = -1"),
        ('[record]\nzone = "Mars/Olympus"\n', "zone = 'Mars/Olympus': not known"),
        ('[record]\ndecimal = "x"\n', "decimal = 'x': give one of"),
        ('[record]\ncolumns = { mv = "x" }\n', 'columns: "mv" = "x": roles are'),
        ('[record]\nsignals = { "A.PV" = "A.PV", "B.PV" = 7 }\n', r'\[record\] signals "B.PV" = 7: give names'),
        ("[record\n", "not TOML"),
    ],
)
def test_a_form_that_is_none_is_refused_in_one_line(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "form.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(RecordingError, match=message) as told:
        form_from_toml(path)
    assert "\n" not in str(told.value)


def test_frames_of_pandas_and_arrow_are_read_like_files(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    when = [BEGIN + timedelta(seconds=float(t)) for t in T]
    by_index = pd.DataFrame({"SP": SP, "PV": PV, "OP": CO}, index=pd.DatetimeIndex(when))
    is_the_loop(read_loop_record([by_index]))
    is_the_loop(read_loop_record([pd.DataFrame({"t": T, "sp": SP, "pv": PV, "co": CO})]))
    table = pa.table({"time": when, "sp": SP, "pv": [None if i == 3 else v for i, v in enumerate(PV)], "co": CO})
    assert len(read_loop_record([table]).recording.t_s) == N - 1
    pq.write_table(table, tmp_path / "a.parquet")
    assert len(read_loop_record([tmp_path / "a.parquet"]).recording.t_s) == N - 1


@pytest.mark.parametrize(
    ("name", "tag", "role"),
    [
        ("FIC101.PV", "FIC101", "pv"),
        ("unit1/TIC-5 Set Point (degC)", "unit1/TIC-5", "sp"),
        ("LC_3_OP [%]", "LC_3", "co"),
        ("Controller Output", "", "co"),
        ("Temperature", "", ""),
        ("2411FIC20102.MV", "2411FIC20102", "mv"),
        ("t [min]", "", "t"),
    ],
)
def test_names_tell_loop_and_role(name: str, tag: str, role: str) -> None:
    assert (named(name).tag, named(name).role) == (tag, role)


def test_mv_is_what_the_other_names_leave_open() -> None:
    assert loops(["F.PV", "F.MV", "F.SV"])["F"].keys() == {"pv", "co", "sp"}
    assert loops(["F.MV", "F.OP"])["F"].keys() == {"pv", "co"}
    assert "mv" in loops(["F.MV"])["F"]


@pytest.mark.slow
@given(st.text(max_size=30))
def test_any_text_can_be_quoted(content: str) -> None:
    import tomllib

    kept = content.encode("utf-8", "ignore").decode()
    assert tomllib.loads(f"x = {quoted(kept)}")["x"] == kept


@given(data=st.data())
@settings(max_examples=examples(60))
def test_any_order_of_columns_delimiters_and_decimals_is_the_same_record(tmp_path_factory, data):
    order = data.draw(st.permutations(range(4)))
    sep = data.draw(st.sampled_from([";", "\t", "|"]))
    mark = data.draw(st.sampled_from([".", ","]))
    columns = [stamps("%Y-%m-%d %H:%M:%S"), *([f"{v}".replace(".", mark) for v in c] for c in (SP, PV, CO))]
    names = ["Time", "X.SP", "X.PV", "X.OUT"]
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_text(text(sep.join(names[i] for i in order), *(columns[i] for i in order), sep=sep), encoding="utf-8")
    is_the_loop(read_loop_record([path]))


def test_a_form_validates_what_it_is_given() -> None:
    for wrong in ({"sp": np.inf}, {"dt_s": 0.0}, {"header": -1}, {"encoding": "klingon"}, {"time_unit": "fortnight"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            replace(RecordForm(), **wrong)


LONG_T = np.arange(300) * 10.0
AGAIN = [
    *(f"{t},50,{50 + i % 3},30" for i, t in enumerate(LONG_T)),
    *(f"{t},50,{60 + i % 3},30" for i, t in enumerate(LONG_T)),
]
OWN = [t.replace(":00", ":03") for t in stamps("%Y-%m-%d %H:%M:%S")]
STAMPED = stamps("%Y-%m-%d %H:%M:%S")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("t,sp,pv,co\n" + "\n".join(AGAIN), "time must increase, so cut the file where another record begins"),
        (text("Time,SP,PV,OP", stamps("%Y-%m-%d %H:%M:%S,120"), SP, PV, CO), "4 names over rows of 5 fields"),
        (text("t,sp,pv,co", range(N), T, SP, PV, CO), "4 names over rows of 5 fields"),
        (text("F1.PV Time,F1.OP Time,F1.PV,F1.OP", STAMPED, OWN, PV, CO), "each signal has times of its own"),
        (text("Time,SP,PV,OP", ["9999-12-31 24:00:00"] * N, SP, PV, CO), "has an unknown format"),
        (text("Time,SP,PV,OP", stamps("%Y-%m-%dT%H:%M:%S+99:99"), SP, PV, CO), "has an unknown format"),
        (text("Time,SP,PV,OP", [f"2024-03-14 24:{i:02d}:00" for i in range(N)], SP, PV, CO), "24:01:00' in row 2"),
        (text("t,sp,pv,co", [0, *[f"{i}e999" for i in range(1, N)]], SP, PV, CO), "at least 3 samples"),
        (text("Tag,t,Value", ["A.OP", "A.OUT", "A.PV"] * 20, T, PV), '"A.OP" and "A.OUT" may both be co of A'),
    ],
)
def test_what_would_be_read_wrong_in_silence_is_refused(written, content, message):
    with pytest.raises(RecordingError) as refused:
        read_loop_record([written(content)])

    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_option_that_a_refusal_names_answers_it(written: Callable[..., Path]) -> None:
    whole = [str(i) for i in range(N)]
    path = written(text("t;sp;pv;co", whole, ["1,150"] * N, [f"1,{100 + i}" for i in range(N)], whole, sep=";"))

    assert read_loop_record([path], RecordForm(decimal=".")).recording.pv[1] == 1101.0
    assert read_loop_record([path], RecordForm(decimal=",")).recording.pv[1] == 1.101
    with pytest.raises(RecordingError, match="no rows after it"):
        read_loop_record([path], RecordForm(decimal=".", header=99))
    with pytest.raises(RecordingError, match='no column "fit"'):
        read_loop_record([path], RecordForm(decimal=".", columns={"quality": "fit"}))


@pytest.mark.parametrize("filler", ["-9999", "99999.00", "1e31", "-999"])
def test_a_number_that_stands_for_a_missing_value_is_left_out(written: Callable[..., Path], filler: str) -> None:
    read = read_loop_record([written(text("t,sp,pv,co", T, SP, [filler, *PV[1:40], filler, *PV[41:]], CO))])
    assert 40 < read.recording.pv.min() < read.recording.pv.max() < 60
    assert in_a_line(read.assumed).endswith("of pv stands for a missing value; 2 values of pv missing: left out")
    near = written(text("t,sp,pv,co", T, 18 * SP, [999, *(18 * PV[1:])], CO))
    assert read_loop_record([near]).recording.pv[0] == 999  # a value like the others

    said = written(text("t,sp,pv,co", T, SP, [-77 if i == 7 else v for i, v in enumerate(PV)], CO))
    assert read_loop_record([said], RecordForm(bad=("-77",))).recording.pv.min() > 0


def test_blank_lines_of_a_spreadsheet_are_no_rows_and_a_missing_stamp_is_told(written: Callable[..., Path]) -> None:
    blank = read_loop_record([written(text("t,sp,pv,co", T, SP, PV, CO) + ",,,\n" * 50)])
    total = read_loop_record([written(text("t,sp,pv,co", T, SP, PV, CO) + ",52,50,30\n")])

    is_the_loop(blank)
    assert blank.assumed == ()
    is_the_loop(total)
    assert in_a_line(total.assumed) == "1 rows without a stamp: left out"


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 2, 4])
def test_a_stamp_that_is_no_number_is_left_out_wherever_it_stands(odd: float, place: int) -> None:
    t_s = np.arange(5.0)
    t_s[place] = odd
    rows, stamps, told = in_order(t_s, "record")
    assert place not in rows
    assert len(rows) == 4
    assert np.all(np.diff(stamps) > 0)
    assert [one.what for one in told] == ["1 rows without a stamp: left out"]


def test_a_long_table_may_hold_text_of_other_tags(written: Callable[..., Path]) -> None:
    both = [("A.SP", SP), ("A.PV", PV), ("A.OP", CO), ("A.MODE", ["AUTO"] * N)]
    rows = [f"{name},{t},{column[i]}" for i, t in enumerate(T) for name, column in both]

    is_the_loop(read_loop_record([written("Tag,t,Value\n" + "\n".join(rows))]))


@pytest.mark.parametrize("origin", [25569, 719529])
@pytest.mark.parametrize("unit", ["", "d"])
def test_days_of_a_spreadsheet_and_of_matlab_begin_on_their_day(written, origin, unit):
    days = [f"{origin + e / 86400:.9f}" for e in EPOCH]
    read = read_loop_record([written(text("t,sp,pv,co", days, SP, PV, CO))], RecordForm(time_unit=unit))

    assert read.begin_s == pytest.approx(EPOCH[0], abs=1.0)
    np.testing.assert_allclose(read.recording.t_s, T, atol=1e-3)
    assert bool(read.assumed) == (not unit)


def test_days_with_so_few_decimals_that_stamps_repeat_are_days(written: Callable[..., Path]) -> None:
    days = [f"{25569 + e / 86400:.3f}" for e in EPOCH]  # a step every 86.4 s
    read = read_loop_record([written(text("t,sp,pv,co", days, SP, PV, CO))], RecordForm())

    assert "days of a spreadsheet" in in_a_line(read.assumed)
    assert read.recording.t_s[-1] - read.recording.t_s[0] == pytest.approx(T[-1] - T[0], abs=200)


def test_a_year_of_two_digits_is_where_the_nights_are_short(written: Callable[..., Path]) -> None:
    night = datetime(2024, 3, 4, 23, 55)  # noqa: DTZ001
    first = read_loop_record([written(text("Time,sp,pv,co", stamps("%y-%m-%d %H:%M:%S", night), SP, PV, CO))])
    late = datetime(2024, 3, 14, 23, 55)  # noqa: DTZ001
    last = read_loop_record([written(text("Time,sp,pv,co", stamps("%d/%m/%y %H:%M:%S", late), SP, PV, CO))])

    is_the_loop(first)
    assert "time as %y-%m-%d" in in_a_line(first.assumed)
    is_the_loop(last)
    assert "time as %d/%m/%y" in in_a_line(last.assumed)


def test_a_line_that_is_no_row_is_named(written: Callable[..., Path]) -> None:
    for times in (T, STAMPED):
        path = written(text("Time,sp,pv,co", times, SP, PV, CO) + "Average,52,50,30\nMaximum,55,51,33\n")
        with pytest.raises(RecordingError, match=r"time 'Average' in row 61 is not of the form of"):
            read_loop_record([path])


def test_of_two_columns_that_may_be_a_signal_the_plain_one_is_taken_or_the_person_asked(written):
    plain = read_loop_record([written(text("t,SP,PV,Actual,Valve Position,Output", T, SP, PV, PV + 5, CO - 9, CO))])
    is_the_loop(plain)
    assert 'co is "Output"' in in_a_line(plain.assumed)

    path = written(text("t,SP,Measured,Actual,OP", T, SP, PV + 5, PV, CO))
    with pytest.raises(RecordingError, match='pv may be "Measured" or "Actual"; say --columns pv=NAME'):
        read_loop_record([path])
    is_the_loop(read_loop_record([path], RecordForm(columns={"pv": "Actual"})))


def test_a_mode_in_numbers_is_told_where_automatic_is_wanted(written: Callable[..., Path]) -> None:
    path = written(text("t,sp,pv,co,mode", T, SP, PV, CO, [1] * 30 + [0] * 30))

    read = read_loop_record([path], in_automatic=True)
    assert "mode is in numbers (0, 1): not used" in in_a_line(read.assumed)


@pytest.mark.parametrize("unit", ["min", "[min]"])
def test_a_row_of_units_tells_that_of_the_time(written: Callable[..., Path], unit: str) -> None:
    path = written(text(f"Time,SP,PV,OP\n{unit},t/h,t/h,%", T / 60, SP, PV, CO))

    is_the_loop(read_loop_record([path]))
