"""Write docs/diagnose.svg: a loop with twice the gain it should have, as `retuner diagnose --plot` shows it.

python scripts/diagnose_picture.py
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from retuner.cli import main
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "diagnose.svg"
LAG_S, DEAD_TIME, NOISE, SEED = 20.0, 3, 0.05, 3


def record() -> np.ndarray:
    """Columns t, sp, pv, co: Kc 6, tau_I 20 s on a lag of 20 s with a dead time of 3 s; setpoint steps and a load."""
    rng = np.random.default_rng(SEED)
    rules = law(PidGains(6.0, 0.3))
    pv, under_way, state = 50.0, [50.0] * DEAD_TIME, start(rules, 50.0, 50.0, 50.0)
    rows = np.zeros((600, 4))
    for i in range(len(rows)):
        sp, seen = (50.0, 53.0, 50.0, 51.0)[i // 150], pv + NOISE * rng.normal()
        state, co = step(rules, state, sp, seen, 1.0)
        rows[i] = i, sp, seen, co
        under_way.append(co)
        pv += (50.0 - pv + under_way.pop(0) - 50.0 + (5.0 if i >= 337 else 0.0)) / LAG_S
    return rows


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "loop.csv"
        np.savetxt(path, record(), delimiter=",", header="t,sp,pv,co", comments="")
        sys.exit(main(["diagnose", str(path), "--co-min", "0", "--co-max", "100", "--plot", str(PICTURE)]))
