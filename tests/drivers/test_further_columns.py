"""Columns that are wanted beside the loop: of long tables, of files and messages of their own, with blanks."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import can
import cantools
import numpy as np
import pandas as pd
import pytest

from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.historian.record_form import RecordForm

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
