"""retuner in your own loop, without CAN: one sample in, now and then one decision out.

    python examples/one_sample_at_a_time.py

A simulated tank is controlled with a quarter of the right gain. After each setpoint step the retuner says what it saw
and what it would change; here the gains are taken over at once, without a bump.
"""

from retuner import GainTable, LoopSample, PidGains, Retuner, RetunerSettings
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.supervision.decision import Action, Mode
from retuner.decision_page.explain import one_line
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.schedule.pid import change, law, start, step
from retuner.schedule.regions import Regions

DT_S = 1.0


def main() -> None:
    """Run the loop and print every decision."""
    regions = Regions("sp", "m", ("tank",), 0.0, (), 10.0)
    table = GainTable("level", regions, (PidGains(kp=12.0, ki=0.3),))
    retuner = Retuner(table, RetunerSettings(sample_time_s=DT_S, pv_span=10.0, mode=Mode.AUTO))
    plant = LinearPlant(LinearProcess(k=0.1, lags_s=(50.0,), theta_s=5.0), start_pv=4.0, noise=0.01, seed=1)

    controller = law(table.gains_of(0))
    state, co = start(controller, 4.0, 4.0, 50.0), 50.0
    for i in range(4000):
        sp = 4.0 if (i // 800) % 2 == 0 else 5.0
        pv = plant.step(co, 0.0, DT_S)
        state, co = step(controller, state, sp, pv, DT_S)
        decision = retuner.observe(LoopSample(i * DT_S, sp, pv, co, x=sp))
        if decision is None:
            continue
        print(f"{decision.t_s:6.0f} s  {one_line(decision)}")
        if decision.action == Action.COMMIT and decision.gains_after is not None:
            renewed = law(decision.gains_after)
            state, controller = change(controller, renewed, state, sp, pv, DT_S), renewed
            retuner.committed(0, decision.gains_after)
    print(f"gains at the end: {retuner.table.gains_of(0)}")


if __name__ == "__main__":
    main()
