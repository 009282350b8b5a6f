"""On vcan0: the firmware in C as a process, examined by `retuner conformance`, then retuned by `retuner run`.

    python firmware_job.py PROGRAM FOLDER SPEED

Leaves conformance.json, run.json and outcome.json in FOLDER. Run by test_socketcan.py, where there is a vcan0.
"""

import json
import subprocess
import sys
from pathlib import Path

CONFIG = """schema = 1
[loop]
name = "bench"
pv_unit = "C"
pv_min = 0.0
pv_max = 120.0
sample_time_s = 2.0
[schedule]
variable = "sp"
[[schedule.region]]
name = "all"
kc = 1.5
tau_i_s = 24.0
tau_d_s = 0.0
[bus]
interface = "socketcan"
channel = "vcan0"
[adaptation]
mode = "off"
[scenario]
duration_s = 120.0
steps = [{ at_s = 0.0, sp = 50.0 }, { at_s = 40.0, sp = 60.0 }]
"""
BUS = ("-i", "socketcan", "-c", "vcan0")


def main() -> int:
    program, folder, speed = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
    (folder / "bench.toml").write_text(CONFIG)
    retuner = [sys.executable, "-P", "-m", "retuner"]
    with subprocess.Popen([program, "-i", "vcan0", "-x", speed, "-s", str(folder / "store")]) as device:
        examined = subprocess.run(
            [*retuner, "conformance", *BUS, "--speed", speed, "--json"], capture_output=True, text=True, check=False
        )
        (folder / "conformance.json").write_text(examined.stdout or examined.stderr)
        ran = subprocess.run(
            [*retuner, "run", str(folder / "bench.toml"), "--speed", speed, "--out", str(folder / "run"), "--json"],
            capture_output=True,
            text=True,
            check=False,
        )
        (folder / "run.json").write_text(ran.stdout or ran.stderr)
        device.terminate()
    outcome = {"conformance": examined.returncode, "run": ran.returncode, "device": device.returncode}
    (folder / "outcome.json").write_text(json.dumps(outcome))
    return 0


if __name__ == "__main__":
    sys.exit(main())
