"""How long does the proof before a change take? By structure, with the models of a 10 % covariance and two borders.

    python benchmarks/guard.py [--seed 1] [--requests 200]

Gains in force are the rule's, off by up to 5 either way; every request has two neighbours with a process of its own.
"""

import argparse
import math
import sys
import time
from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.guard import ChangeRequest, GuardSettings, NeighbourBorder, allowed, prove
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import PidGains

STD = 0.1
SAMPLES_PER_THETA = 8
MODELS = {
    "first order": ProcessModel(ProcessType.FOPDT, 1.0, 10.0, 0.0, 1.0),
    "two lags": ProcessModel(ProcessType.SOPDT, 1.0, 10.0, 3.0, 1.0),
    "complex poles": ProcessModel(ProcessType.SOPDT, 1.0, 3.0, 3.0, 1.0, 0.8),
    "integrating": ProcessModel(ProcessType.INTEGRATING, 0.1, theta_s=1.0),
    "integrating + lag": ProcessModel(ProcessType.INTEGRATING_LAG, 0.1, 0.0, 2.0, 1.0),
}


def drawn(model: ProcessModel, rng: np.random.Generator, settings: GuardSettings) -> ChangeRequest:
    """A request with gains off at random and two neighbours."""
    sample_time_s = model.theta_s / SAMPLES_PER_THETA
    x = parameters_of(model)
    models = allowed(LogModel(x, STD**2 * np.eye(len(x)), 1, model.type), (), 0.0, settings)
    proposal = simc(replace(model, theta_s=model.theta_s + sample_time_s / 2))
    kp, ki = np.exp(rng.uniform(-math.log(5), math.log(5), 2))
    old = PidGains(proposal.gains.kp * kp, proposal.gains.ki * ki)
    near = tuple(replace(p, model=replace(p.model, k=p.model.k * 1.2)) for p in models)
    borders = tuple(NeighbourBorder(name, old, near, 0.6) for name in ("below", "above"))
    return ChangeRequest(old, old, proposal, models, sample_time_s, borders=borders)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--requests", type=int, default=200, help="for each structure")
    options = parser.parse_args()
    settings = GuardSettings()
    sys.stdout.write(f"seed {options.seed}, {options.requests} requests each; CPU time of a proof in ms\n")
    for name, model in MODELS.items():
        rng = np.random.default_rng(options.seed)
        spent, accepted = [], 0
        for _ in range(options.requests):
            request = drawn(model, rng, settings)
            begun = time.process_time()
            accepted += prove(request, settings).accepted
            spent.append(1e3 * (time.process_time() - begun))
        median, most = float(np.median(spent)), float(np.percentile(spent, 95))
        sys.stdout.write(f"  {name:18s} median {median:6.1f}   95 % {most:6.1f}   accepted {accepted}\n")


if __name__ == "__main__":
    main()
