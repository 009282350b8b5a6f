"""Real SocketCAN, ill-treated: all outages recovered from, all losses reported, no gains that nobody ordered as a set.

    python scripts/socketcan/run.py --timeout 1800 -- PYTHON -P scripts/socketcan/faults.py [PART ...] [--share S]

Parts, all without names: updown (interface down and up 100 times), recreate (removed and made anew 20 times), overflow
(receive queue, 20 bursts of 5,000 frames), clock (wall clock set to and fro 20 times), errors (bus-off and other error
frames, 20 of each), gateway (cangw corrupts or withholds one kind of frame after the other), netem (loss, duplication,
delay and reordering on vxcan), foreign (cangen floods, forged frames, replayed traffic), kill (kill -9 of host and
device at random moments, 100 times each). --share 0.1 makes a tenth of each. Prints a line of JSON per part; status 1
when anything was wrong; what the kernel lacks is said and does not count.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from ill_treatment import clock, errors, foreign, gateway, netem, overflow, recreate, updown
from kills import kill

PARTS: dict[str, Callable[[float, int], dict[str, object]]] = {
    "updown": updown,
    "recreate": recreate,
    "overflow": overflow,
    "clock": clock,
    "errors": errors,
    "gateway": gateway,
    "netem": netem,
    "foreign": foreign,
    "kill": kill,
}
MODULES = ("net/can/can-gw", "drivers/net/can/vxcan", "net/sched/sch_netem")


def main() -> int:
    """Run the parts that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", help=", ".join(PARTS))
    parser.add_argument("--share", type=float, default=1.0, help="share of the full counts (1)")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    folder = Path("/usr/lib/uml/modules") / os.uname().release / "kernel"
    for module in MODULES:  # elsewhere the kernel loads them by itself
        subprocess.run(["insmod", folder / f"{module}.ko"], check=False, capture_output=True)
    wrong = 0
    for name in chosen.parts or PARTS:
        started = time.monotonic()
        result = PARTS[name](chosen.share, chosen.seed)
        result = {"part": name, "seconds": round(time.monotonic() - started, 1), **result}
        sys.stdout.write(json.dumps(result) + "\n")
        sys.stdout.flush()
        wrong += len(result.get("wrong", []))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
