"""What a process does before the first question of a loop: two decisions on a record of nobody, so that no real one
waits for imports, nor the loop when it enters one. Only the second has something to join its record with (filterpy).
"""

from collections import deque
from functools import cache
from threading import Thread

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

GAINS = PidGains(0.6, 0.01)
K, LAG, DEAD = 1.0, 60.0, 10  # The process: gain, lag in samples, dead time in samples of a second
STEPS_AT, LONGEST = (40, 500), 1200  # samples of the setpoint's steps to and fro, and the last one
DECISIONS = 2


def warm_up() -> Decision | None:
    """Watch a sluggish loop of first order until there is a decision on its second setpoint response; that decision."""
    regions = Regions("sp", "%", ("all",), 0.0, (), 100.0, 0.0, 0.0)
    retuner = Retuner(GainTable("nobody", regions, (GAINS,)), RetunerSettings(1.0, 100.0, Mode.AUTO))
    pv, integral, late, made = 50.0, 50.0, deque([50.0] * DEAD), 0
    for i in range(LONGEST):
        sp = 60.0 if STEPS_AT[0] <= i < STEPS_AT[1] else 50.0
        seen = pv + 0.02 * ((i * 7919 % 101) / 50.0 - 1.0)  # as good as noise, and the same every time
        integral += GAINS.ki * (sp - seen)
        co = integral + GAINS.kp * (sp - seen)
        late.append(co)
        pv += (K * late.popleft() - pv) / LAG
        decision = retuner.observe(LoopSample(float(i), sp, seen, co, LoopMode.AUTO, x=sp))
        made += decision is not None
        if made == DECISIONS:
            return decision
    return None


@cache
def warm_up_beside() -> Thread:
    """The thread that does it while a loop runs on; once a process."""
    thread = Thread(target=warm_up, name="warm-up")
    thread.start()
    return thread
