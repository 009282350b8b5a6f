"""What a step of PidController costs that decides something, in a process that has loaded nothing else: CPU seconds as
JSON, in order. On a loop of 10 s with a dead time of 3 s, seed 4040; benchmarks/costs.py asks it.

The loop waits for the thread that loads what a decision needs, as one in real time does between its samples.
"""

import json
import sys
import threading
import time

import numpy as np

from retuner import PidController, PidGains

SEED, SAMPLES, DT_S = 4040, 4000, 0.5
DECIDING_S = 0.005  # A step that takes longer decided something


def main() -> None:
    rng, pv = np.random.default_rng(SEED), 50.0
    controller = PidController(PidGains(0.6, 0.12), dt_s=DT_S, pv_range=(0, 100))
    late, times = [50.0] * 6, []
    for i in range(SAMPLES):
        setpoint = 60.0 if (i // 250) % 2 else 50.0
        begun = time.process_time()
        late.append(controller.step(setpoint, pv + float(rng.normal(0, 0.05))))
        times.append(time.process_time() - begun)
        for beside in threading.enumerate()[1:]:
            beside.join()
        pv += DT_S / 10.0 * (0.8 * (late.pop(0) - 50.0) + 50.0 - pv)
    json.dump([spent for spent in times if spent > DECIDING_S], sys.stdout)


if __name__ == "__main__":
    main()
