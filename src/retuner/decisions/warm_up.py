"""What a process does before the first question of a loop: a decision on a record of nobody, so that the first real one
does not wait for imports, nor the loop when it enters one.
"""

from collections import deque

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

GAINS = PidGains(0.6, 0.01)
K, LAG, DEAD = 1.0, 60.0, 10
"""The process: gain, lag in samples, dead time in samples of a second."""
STEP_AT, LONGEST = 40, 900  # sample of the setpoint step, and the last one


def warm_up() -> Decision | None:
    """Watch a sluggish loop of first order until there is a decision on its setpoint response; the decision."""
    regions = Regions("sp", "%", ("all",), 0.0, (), 100.0, 0.0, 0.0)
    retuner = Retuner(GainTable("nobody", regions, (GAINS,)), RetunerSettings(1.0, 100.0, Mode.AUTO))
    pv, integral, late = 50.0, 50.0, deque([50.0] * DEAD)
    for i in range(LONGEST):
        sp = 50.0 if i < STEP_AT else 60.0
        seen = pv + 0.02 * ((i * 7919 % 101) / 50.0 - 1.0)  # as good as noise, and the same every time
        integral += GAINS.ki * (sp - seen)
        co = integral + GAINS.kp * (sp - seen)
        late.append(co)
        pv += (K * late.popleft() - pv) / LAG
        sample = LoopSample(float(i), sp, seen, co, LoopMode.AUTO, x=sp)
        decision = retuner.observe(sample)
        if decision is not None:
            return decision
    return None
