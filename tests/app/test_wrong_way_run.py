"""A run on a controller that acts the wrong way does not end as if all were well."""

from pathlib import Path

import pytest

from retuner.cli import main

BENCH = Path(__file__).parents[2] / "examples" / "bench.toml"


def test_a_run_that_ended_the_wrong_way_says_so_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "bench.toml"
    text = BENCH.read_text(encoding="utf-8")
    assert "k = 0.4" in text
    config.write_text(text.replace("k = 0.4", "k = -0.4"), encoding="utf-8")
    assert main(["run", str(config), "--out", str(tmp_path / "out"), "--no-compare"]) == 2
    said = capsys.readouterr()
    assert "the controller acts the wrong way; turn its action" in said.err
    assert (tmp_path / "out" / "report.html").is_file()
    assert "Traceback" not in said.err
