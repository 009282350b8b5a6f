"""What a schedule from records says of itself: the unit of co in its gains, and what changes along the variable."""

from pathlib import Path

import numpy as np

from retuner.cli import main
from retuner.schedule.document import from_toml

DAY = Path(__file__).parents[2] / "examples" / "records" / "day.csv"


def test_the_gain_table_of_records_names_their_unit_of_co(tmp_path: Path) -> None:
    """co of 4 to 20 mA: read as percent, the gains would be six times off."""
    whole = np.genfromtxt(DAY, delimiter=",", names=True)
    whole["co"] = 4.0 + 0.16 * whole["co"]
    record = tmp_path / "day.csv"
    np.savetxt(record, np.stack([whole[n] for n in whole.dtype.names], 1), delimiter=",",
               header=",".join(whole.dtype.names), comments="")  # fmt: skip
    assert main(["schedule", str(record), "--by", "pv", "--out", str(tmp_path / "out")]) == 0
    told = f"in the unit of the records, where it runs from {whole['co'].min():g} to {whole['co'].max():g}"
    for name in ("gains.toml", "schedule.toml"):
        text = (tmp_path / "out" / name).read_text(encoding="utf-8")
        assert told in text.splitlines()[0]
    assert "percent" not in (tmp_path / "out" / "gains.toml").read_text(encoding="utf-8")
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "does not change with it" not in report
    assert "The process changes with pv: slope gain k/tau (from " in report
    assert from_toml((tmp_path / "out" / "gains.toml").read_text(encoding="utf-8")).gains
