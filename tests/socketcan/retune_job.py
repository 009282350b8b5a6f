"""Run where there is a vcan0: a device and a host as two processes, and a third that writes down every frame.

    python retune_job.py CONFIG OUT SPEED

Leaves in OUT: outcome.json (exit statuses), run.json (what `retuner run --json` printed), capture.log (candump's
format), device.err, run.err, and in OUT/run what a run leaves.
"""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import can

CHANNEL = "vcan0"
PATIENCE_S = 60.0  # for the device's first frame: imports take their time on one emulated CPU
RETUNER = [sys.executable, "-P", "-c", "import sys; from retuner.cli import main; sys.exit(main())"]


def await_frame(bus: can.BusABC, device: "subprocess.Popen[bytes]") -> bool:
    for _ in range(int(PATIENCE_S)):
        if bus.recv(1.0) is not None:
            return True
        if device.poll() is not None:
            return False
    return False


def main() -> int:
    config, out, speed = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    where = ["--interface", "socketcan", "--channel", CHANNEL, "--speed", speed]
    outcome: dict[str, object] = {"kernel": os.uname().release}
    with (
        can.Bus(interface="socketcan", channel=CHANNEL) as bus,
        can.Bus(interface="socketcan", channel=CHANNEL) as ear,
        can.CanutilsLogWriter(out / "capture.log") as capture,
        (out / "device.err").open("wb") as device_err,
        (out / "run.err").open("wb") as run_err,
        (out / "run.json").open("wb") as answer,
    ):
        notifier = can.Notifier(ear, [capture])
        device = subprocess.Popen([*RETUNER, "device", str(config), *where], stderr=device_err)
        outcome["heard"] = await_frame(bus, device)
        run = [*RETUNER, "run", str(config), *where, "--out", str(out / "run"), "--json"]
        outcome["run"] = subprocess.run(run, stdout=answer, stderr=run_err, check=False).returncode
        device.send_signal(signal.SIGINT)
        outcome["device"] = device.wait(PATIENCE_S)
        notifier.stop()
    (out / "outcome.json").write_text(json.dumps(outcome))
    return 0


if __name__ == "__main__":
    sys.exit(main())
