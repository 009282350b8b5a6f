"""Are two processes in one region told apart, and equal neighbours found? Whole sessions on simulated plants.

    python benchmarks/region_advice.py [FIRST_SEED [SEEDS]]

Each case is a configuration as a user would write it, run in simulated time over CAN in mode advise; what counts is
what adaptive/region_model/region_advice.py says at its end. Seeds below 100 were used in development.

  two processes   one region over a boiler whose gain is 2 times larger at 92 than at 40 degC; both are visited in turn
  one process     the same steps on a process that is the same everywhere
  changed once    that process with its lag and delay doubled half way: a change in time is no second region
  equal           two regions with a border through that process
  different       two regions with the border between 40 and 92 degC of the boiler
"""

import sys
from collections import Counter

from retuner.adaptive.region_model.region_advice import AdviceSettings, RegionAdvice, region_advice
from retuner.adaptive.supervision.decision import Mode
from retuner.config.loading import parse_config
from retuner.config.model import Config
from retuner.session.running import Run, nothing

SEEDS = (2028, 3)
LOOP = """schema = 1
[loop]
name = "case"
pv_unit = "degC"
pv_min = 20.0
pv_max = 120.0
sample_time_s = 2.0
[schedule]
bounds = [{bounds}]
"""
REGION = '[[schedule.region]]\nname = "{name}"\nkc = 0.5\ntau_i_s = 45.0\n'
LINEAR = (
    '[device]\nseed = {seed}\n[device.plant]\nkind = "linear"\nk = 1.3\nlags_s = [40.0, 4.0]\ntheta_s = 8.0\n'
    "start_pv = 40.0\nstart_co_pct = 40.0\nnoise = 0.1\n"
)
BOILER = '[device]\nseed = {seed}\n[device.plant]\nkind = "boiler"\nstart_c = 40.0\n'
STEP_S = 420.0
APART = (40.0, 45.0, 40.0, 66.0, 92.0, 98.0, 92.0, 66.0)
NEAR = (40.0, 45.0, 40.0, 46.0, 52.0, 58.0, 52.0, 46.0)


def scenario(sps: tuple[float, ...], slow_from: int | None = None) -> str:
    """Setpoint steps, three times over; slow_from: the step from which on less flows."""
    lines = []
    for i, sp in enumerate(sps * 3):
        load = ", load = -50.0" if i == slow_from else ""
        lines.append(f"    {{ at_s = {i * STEP_S}, sp = {sp}{load} }},")
    return f"[scenario]\nduration_s = {3 * len(sps) * STEP_S}\nsteps = [\n" + "\n".join(lines) + "\n]\n"


def configured(case: str, seed: int) -> Config:
    """The configuration of a case."""
    bounds = {"equal": "49.0", "different": "66.0"}.get(case, "")
    head = LOOP.format(bounds=bounds)
    regions = "".join(REGION.format(name=name) for name in (("low", "high") if bounds else ("all",)))
    plant = (BOILER if case in {"two processes", "changed once", "different"} else LINEAR).format(seed=seed)
    steps = {
        "two processes": scenario(APART),
        "different": scenario(APART),
        "one process": scenario(NEAR),
        "changed once": scenario((40.0, 43.0) * 4, 10),
        "equal": scenario(NEAR),
    }[case]
    return parse_config(head + regions + plant + steps)


def advised(case: str, seed: int) -> tuple[tuple[RegionAdvice, ...], int]:
    """What is proposed at the end of a run, and from how many records."""
    config = configured(case, seed)
    session = Run(config, nothing, mode=Mode.ADVISE).simulated().loops[0]
    region_models = session.retuner.region_models
    found = region_advice(session.table.regions, region_models, config.loop.sample_time_s, AdviceSettings())
    return found, sum(len(region_model.points) for region_model in region_models.values())


def main() -> None:
    """Run all cases and print the table."""
    first, count = (int(a) for a in (sys.argv[1:] + [str(n) for n in SEEDS[len(sys.argv) - 1 :]])[:2])
    print(f"{'case':<16}{'runs':>5}{'records':>9}{'split':>7}{'merge':>7}")
    for case in ("two processes", "one process", "changed once", "equal", "different"):
        told: Counter[str] = Counter()
        records = 0
        for seed in range(first, first + count):
            found, n = advised(case, seed)
            records += n
            told.update({str(one.kind) for one in found})
            for one in found:
                print(f"    seed {seed}: {one.sentence}")
        print(f"{case:<16}{count:>5}{records / count:>9.1f}{told['split']:>7}{told['merge']:>7}", flush=True)


if __name__ == "__main__":
    main()
