"""Deterministic simulation of the CAN protocol: real code of host and device, one seed, simulated time, every fault.

    python benchmarks/simulation.py                                   100 seeds, some seconds
    python benchmarks/simulation.py --seeds 10000 --steps 10000       1e8 steps: `make nightly`
    python benchmarks/simulation.py --first-seed 4711 --seeds 1       one seed again
    python benchmarks/simulation.py --device firmware                 drivers/firmware, compiled here, is the device
    python benchmarks/simulation.py --device both                     and must answer as the virtual one does

With --state FILE a campaign that was stopped goes on where it was; when the code has changed, behind the seeds that
others have had, and their steps are told beside its own. Exit status 1 when
a promise was broken, or when a naive protocol over the same bus was not seen to fail.
"""

import argparse
import math
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bus_simulation.campaign import DEVICES, Campaign
from bus_simulation.naive import KIND, NaiveWorld

NAIVE_STEPS = 20_000


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--steps", type=int, default=1000, help="controller samples per seed")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--hours", type=float, default=math.inf, help="begin no seed after so many")
    parser.add_argument("--state", type=Path, default=None, help="file that keeps what is done")
    parser.add_argument("--device", choices=DEVICES, default="virtual", help="the firmware in C, or both side by side")
    options = parser.parse_args()
    if min(options.seeds, options.steps, options.processes) < 1 or options.first_seed < 0:
        parser.error("--seeds, --steps and --processes must be 1 or more, --first-seed 0 or more")
    # The protocol itself; whether a promise was broken
    campaign = Campaign(
        options.first_seed, options.seeds, options.steps, options.state, device=options.device, hours=options.hours
    )
    done_before = len(campaign.done)
    try:
        for outcome in campaign.run(options.processes):
            if outcome.broken:
                print(
                    f"seed {outcome.seed}: {outcome.broken}\n    replay: python benchmarks/simulation.py "
                    f"--first-seed {outcome.seed} --seeds 1 --steps {options.steps}",
                    flush=True,
                )
    except KeyboardInterrupt:
        campaign.save()
    counts, seeds = campaign.counts, len(campaign.done)
    rate = counts["steps"] / campaign.busy_s if campaign.busy_s else 0.0
    print(
        f"{seeds} seeds ({done_before} of them from before), {counts['steps']:,} fault-injected steps, "
        f"{counts['faults']:,} faults on frames, {rate:,.0f} steps/s on {options.processes} processes"
    )
    for name in sorted(counts, key=lambda name: -counts[name]):
        if name not in {"steps", "faults"}:
            print(f"    {counts[name]:>12,}  {name}")
    print(f"promises broken in {len(campaign.broken)} of {seeds} seeds")
    if campaign.before:
        print(f"{campaign.steps_of_all():,} steps with those of {len(campaign.before)} codes before this one")
    broken = bool(campaign.broken)
    return int(broken or not _naive_fail())


def _naive_fail() -> bool:
    """The naive protocols over the same bus; whether each was seen to fail."""
    failed = True
    for per_gain, kind in zip((True, False), KIND, strict=True):
        counts = NaiveWorld(1, per_gain=per_gain).run(NAIVE_STEPS)
        broken = {name: count for name, count in sorted(counts.items()) if name != "steps"}
        print(f"naive, {kind}: " + ", ".join(f"{name} broken in {n / NAIVE_STEPS:.1%}" for name, n in broken.items()))
        failed = failed and counts["running_set_is_a_committed_one"] > 0 and counts["finite_and_inside_the_box"] > 0
    return failed


if __name__ == "__main__":
    sys.exit(main())
