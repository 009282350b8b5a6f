"""A foreign controller in a process of its own, over udp_multicast that does not leave this host."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
RETUNER = [sys.executable, "-P", "-c", "import sys; from retuner.cli import main; sys.exit(main())"]
GROUP, SPEED = "239.74.163.9", "20"


@pytest.mark.slow
@pytest.mark.uncounted
@pytest.mark.parametrize("profile", [pytest.param("odrive", marks=pytest.mark.nightly), "cia404"])
def test_two_processes_speak_with_each_other(profile: str, tmp_path: Path) -> None:
    where = ["-i", "udp_multicast", "-c", GROUP, "--speed", SPEED if profile == "cia404" else "1"]
    text = (EXAMPLES / f"{profile}.toml").read_text()
    length = "6000.0" if profile == "cia404" else "120.0"
    text = text.replace(f"duration_s = {length}", f"duration_s = {'150.0' if profile == 'cia404' else '12.0'}")
    last = text.index("{ at_s = 1200.0" if profile == "cia404" else "{ at_s = 20.0")
    config = tmp_path / "loop.toml"
    config.write_text(text[:last] + "]\n")
    if profile == "cia404":
        config.write_text(config.read_text().replace("at_s = 200.0", "at_s = 20.0"))
    with subprocess.Popen([*RETUNER, "device", str(config), *where], stderr=subprocess.PIPE, text=True) as device:
        try:
            assert "Ctrl-C ends it" in device.stderr.readline()
            out = tmp_path / "run"
            run = subprocess.run(
                [*RETUNER, "run", str(config), *where, "--out", str(out), "--json"],
                capture_output=True,
                text=True,
                check=False,
                timeout=120,
            )
        finally:
            device.terminate()
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["gains"]
    trend = (out / "trend.csv").read_text().splitlines()
    columns = trend[0].split(",")
    pv = [float(line.split(",")[columns.index("pv")]) for line in trend[1:]]
    assert len(pv) > 50
    assert max(pv) - min(pv) > 3.0  # the setpoint step has reached the plant, and the plant the host
