"""retuner in your own loop, without CAN: one sample in, now and then one decision out.

    python examples/one_sample_at_a_time.py

A simulated tank is controlled with a quarter of the right gain. After each setpoint step the retuner says what it saw
and what it would change. What a decision asks for is put in force without a bump, and told: `committed` after a change
(COMMIT), `restored` after what was taken back (RESTORE). A loop that leaves the second one out stays on a bad set; one
that just stops leaves a change undecided: `abort` says what is to run then. Where somebody else sets gains beside it,
tell that as well: `retuner.edited(gains)`; they are kept.

A decision takes a tenth of a second to a second. Where that may not hold up the loop, give the retuner to a
`BackgroundRetuner`: its `observe` never waits, the decision comes with a later sample.
"""

from retuner import GainTable, LoopSample, PidGains, Retuner, RetunerSettings
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.trial.phase import TrialEvent
from retuner.decision_page.decision_words import one_line
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.schedule.pid import change, law, start, step
from retuner.schedule.regions import Regions

DT_S = 1.0


class Tank:
    """The loop: a simulated plant under a PID controller whose gains may change at any sample, without a bump."""

    def __init__(self, gains: PidGains) -> None:
        self._plant = LinearPlant(LinearProcess(k=0.1, lags_s=(50.0,), theta_s=5.0), start_pv=4.0, noise=0.01, seed=1)
        self._law = law(gains)
        self._state, self._co = start(self._law, 4.0, 4.0, 50.0), 50.0
        self._sp = self._pv = 4.0

    def sample(self, t_s: float, sp: float) -> LoopSample:
        """Read pv, compute co."""
        self._sp, self._pv = sp, self._plant.step(self._co, 0.0, DT_S)
        self._state, self._co = step(self._law, self._state, sp, self._pv, DT_S)
        return LoopSample(t_s, sp, self._pv, self._co, x=sp)

    def write(self, gains: PidGains) -> None:
        """Other gains from now on."""
        renewed = law(gains)
        self._state = change(self._law, renewed, self._state, self._sp, self._pv, DT_S)
        self._law = renewed


def obey(decision: Decision, tank: Tank, retuner: Retuner) -> None:
    """Do what a decision asks for, and tell the retuner that it is done."""
    print(f"{decision.t_s:6.0f} s  {one_line(decision)}")
    region = retuner.region
    if decision.action == Action.WRITE and decision.gains_after is not None:
        if not decision.later:  # gains for a region where the loop is not: the table takes them, nothing is written
            tank.write(decision.gains_after)
        retuner.committed(retuner.table.index(decision.region), decision.gains_after)
    elif decision.action == Action.RESTORE and region is not None:
        tank.write(retuner.table.at(region, *retuner.scheduled))  # the table has what is to run, wherever the loop is
        retuner.restored()


def main() -> None:
    """Run the loop and print every decision."""
    regions = Regions("sp", "m", ("tank",), 0.0, (), 10.0)
    table = GainTable("level", regions, (PidGains(kp=12.0, ki=0.3),))
    retuner = Retuner(table, RetunerSettings(sample_time_s=DT_S, pv_span=10.0, mode=Mode.AUTO))
    tank = Tank(table.gains_of(0))
    for i in range(4000):
        decision = retuner.observe(tank.sample(i * DT_S, 4.0 if (i // 800) % 2 == 0 else 5.0))
        if decision is not None:
            obey(decision, tank, retuner)
    last = retuner.abort(TrialEvent.STOPPED)  # a change that is not decided yet: what is to run when nobody watches?
    if last is not None:
        obey(last, tank, retuner)
    print(f"gains at the end: {retuner.table.gains_of(0)}")


if __name__ == "__main__":
    main()
