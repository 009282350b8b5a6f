"""Raw signals, 4 to 20 mA and counts, come out in the unit of the plant; what is no scaling is refused."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import retuner
from retuner.drivers.historian.record_form import RecordForm, form_from_toml
from retuner.drivers.historian.scaling import Scaling
from retuner.drivers.recorded.recording import RecordingError

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
