"""Recordings: what is read, and that everything malformed ends in one line that says where."""

import os
import random
from collections import deque
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import can
import cantools
import numpy as np
import pandas as pd
import pytest
from effort import examples, sized
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plain_recording import read_recording
from speaking import CODEC

from retuner.drivers.device import DeviceConflict
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.protocol.checksum import sample_crc
from retuner.drivers.protocol.frames import Heartbeat, TelemetryPv, TelemetrySp
from retuner.drivers.recorded.recording import Recording, RecordingError, require_excitation, require_setpoint
from retuner.drivers.telemetry.sample_assembly import SampleJoiner

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


def test_columns_that_do_not_exist_are_named(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
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


# ---- Columns that are wanted beside the loop: of long tables, of files and messages of their own, with blanks

N = 60
T = np.arange(N) * 10.0
PV, CO, FLOW = 50 + np.sin(T / 27), 30 + np.cos(T / 90), 10 + T / 100
WHEN = [datetime(2024, 3, 14, 21, 55, tzinfo=UTC) + timedelta(seconds=float(t)) for t in T]
DBC = """VERSION ""
BU_: N
BO_ 257 FIC101: 8 N
 SG_ PV : 0|32@1- (0.0001,0) [0|0] "" N
 SG_ CO : 32|32@1- (0.0001,0) [0|0] "" N
BO_ 300 Plant: 4 N
 SG_ FI104 : 0|32@1- (0.0001,0) [0|0] "" N
"""
WANTED = RecordForm(sp=50.0, others=("FI104",))


def flow_of(source: object, form: RecordForm = WANTED) -> np.ndarray:
    sources = source if isinstance(source, list) else [source]
    read = read_loop_record(sources, form)
    assert len(read.recording.t_s) == N
    assert read.recording.pv == pytest.approx(PV, abs=1e-3)
    return read.others["FI104"]


def test_a_long_table_gives_a_further_tag(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    rows = [
        f"{tag},{when:%Y-%m-%d %H:%M:%S},{values[i]:.4f}"
        for i, when in enumerate(WHEN)
        for tag, values in (("FIC1.PV", PV), ("FIC1.OP", CO), ("FI104", FLOW))
    ]
    path.write_text("\n".join(["tag,time,value", *rows]) + "\n")
    assert flow_of(path) == pytest.approx(FLOW, abs=1e-3)


def test_a_further_column_may_stand_in_a_file_of_its_own(tmp_path: Path) -> None:
    files = []
    for name, values in (("FIC1.PV", PV), ("FIC1.OP", CO), ("FI104", FLOW)):
        files.append(tmp_path / f"{name}.csv")
        head = "time,FI104" if name == "FI104" else "time,value"
        rows = [f"{when:%Y-%m-%d %H:%M:%S},{v:.4f}" for when, v in zip(WHEN, values, strict=True)]
        files[-1].write_text("\n".join([head, *rows]) + "\n")
    assert flow_of(files) == pytest.approx(FLOW, abs=1e-3)


def test_blanks_in_a_further_column_take_no_row_from_the_loop(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    rows = [f"{t},50,{PV[i]:.4f},{CO[i]:.4f},{'' if i % 50 == 7 else f'{FLOW[i]:.4f}'}" for i, t in enumerate(T)]
    path.write_text("\n".join(["t,sp,pv,co,FI104", *rows]) + "\n")
    held = FLOW.copy()
    held[[7, 57]] = FLOW[[6, 56]]
    assert flow_of(path, RecordForm(others=("FI104",))) == pytest.approx(held, abs=1e-3)


def test_a_frame_with_times_of_a_zone_is_read() -> None:
    assert flow_of(pd.DataFrame({"pv": PV, "co": CO, "FI104": FLOW}, index=pd.DatetimeIndex(WHEN))) == pytest.approx(
        FLOW
    )


def test_a_signal_of_a_bus_log_may_be_the_further_one(tmp_path: Path) -> None:
    (tmp_path / "plant.dbc").write_text(DBC, encoding="ascii")
    database = cantools.database.load_string(DBC, "dbc")
    with can.Logger(str(tmp_path / "x.asc")) as logger:
        for i, t in enumerate(T):
            values = {"Plant": {"FI104": FLOW[i]}, "FIC101": {"PV": PV[i], "CO": CO[i]}}
            for j, (name, signals) in enumerate(values.items()):
                key, data = database.get_message_by_name(name).frame_id, database.encode_message(name, signals)
                stamp = 1.7e9 + t + 0.01 * j
                logger.on_message_received(
                    can.Message(timestamp=stamp, arbitration_id=key, data=data, is_extended_id=False)
                )
    form = RecordForm(sp=50.0, others=("FI104",), dbc=(str(tmp_path / "plant.dbc"),))
    assert flow_of(tmp_path / "x.asc", form) == pytest.approx(FLOW, abs=0.11)


# ---- Telemetry and heartbeats of the past sent again: the session's clock never runs ahead of the controller's

BEAT = 5  # Samples between two heartbeats, here
LEARNING, KNOWN = 100, 2 * BEAT
"""Samples that the clock may be ahead of the controller: before its rhythm is known, and then."""


def halves(number: int, said: float) -> tuple[TelemetryPv, TelemetrySp]:
    pv = TelemetryPv(number % 256, said, 50.0)
    sp = TelemetrySp(number % 256, 7.0, 1, 0, 1, 0)
    return pv, replace(sp, crc=sample_crc(1, pv, sp))


class Overheard:
    """What a repeater on the bus of a bench has heard, to be sent again."""

    def __init__(self, bench) -> None:
        self.bench = bench
        self.heard = deque(maxlen=4000)
        send = bench.far.send

        def heard(message) -> None:
            if isinstance(CODEC.decode(message), TelemetryPv | TelemetrySp | Heartbeat):
                self.heard.append(message)
            send(message)

        bench.far.send, self.send = heard, send

    def again(self, kinds, samples: int) -> None:
        """All of the kinds from so many samples ago on."""
        for message in list(self.heard)[-samples * 2 - samples // BEAT :]:
            if isinstance(CODEC.decode(message), kinds):
                self.send(message)


@pytest.mark.slow
@pytest.mark.parametrize("back", sized([130, 255, 1000], [130, 255, 1000], [130, 200, 255, 300, 1000]))
@pytest.mark.parametrize("kinds", [(TelemetryPv, TelemetrySp), (TelemetryPv, TelemetrySp, Heartbeat)])
def test_a_replay_does_not_move_the_clock(bench, back: int, kinds) -> None:
    repeater = Overheard(bench)
    bench.run(1100)
    ahead = []
    for _ in range(60):
        repeater.again(kinds, back)
        ahead += [round(sample.t_s / 2) - bench.device.sample for sample in bench.samples(bench.run(1))]
    assert max(ahead, default=0) <= KNOWN
    calm = bench.run(2 * LEARNING)
    times = [round(sample.t_s / 2) for sample in bench.samples(calm)]
    assert times[-1] == bench.device.sample
    assert times[-BEAT * 4 :] == list(range(times[-1] - BEAT * 4 + 1, times[-1] + 1))
    assert bench.host.connected


def test_a_replay_is_told(bench) -> None:
    repeater = Overheard(bench)
    bench.run(300)
    told = []
    for _ in range(60):
        repeater.again((TelemetryPv, TelemetrySp, Heartbeat), 200)
        told += bench.run(1)
    assert any(isinstance(event, DeviceConflict) for event in told)


def test_a_counter_that_begins_anew_in_the_same_epoch_is_told_and_moves_no_clock(bench) -> None:
    bench.run(400)
    bench.device.sample = 3
    events = bench.run(60)
    assert not bench.samples(events)
    assert any(isinstance(event, DeviceConflict) for event in events)


@pytest.mark.slow
@pytest.mark.uncounted
@given(seed=st.integers(0, 2**32), beat=st.sampled_from([1, 2, 5, 20, 100]), start=st.integers(0, 2**20))
@settings(max_examples=examples(100))
def test_no_past_telemetry_however_it_is_sent_again_runs_the_clock_ahead(seed: int, beat: int, start: int) -> None:
    """Samples of the device in time, and between them anything it has said, in any order and as often as one likes."""
    rng, joiner = random.Random(seed), SampleJoiner(1.0)
    joiner.set_reference(start)
    past = [(None, half) for n in range(max(start - 255, 0), start + 1) for half in halves(n, float(n))]
    often, longest, shuffled = rng.random(), rng.choice([1, 8, 64, 400]), rng.random() < 0.3
    newest = start - 1.0
    for number in range(start + 1, start + 700):
        fresh = [(None, half) for half in halves(number, float(number))]
        fresh += [(number, None)] if number % beat == 0 else []
        past += fresh
        sent = list(fresh)
        if rng.random() < often:
            back = rng.randrange(min(len(past), 2000))
            sent += past[-back - 1 :][: rng.randint(1, longest)]
        if shuffled:
            rng.shuffle(sent)
        allowed = max(LEARNING, 2 * beat) if number - start <= 256 else max(2 * beat, 8)
        for heartbeat, half in sent:
            if half is None:
                joiner.set_reference(heartbeat)
            elif (joined := joiner.take(half)) is not None:
                assert newest < joined.sample.t_s <= number + allowed
                newest = joined.sample.t_s
    assert newest >= start + 700 - 2 * max(beat, 8)
