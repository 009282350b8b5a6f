"""What a swing shows counts: no loop that every model calls unstable stays so behind one sentence, or behind none."""

import math
from dataclasses import replace

import pytest

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.supervision.decision import Action, Decision
from retuner.pid_controller import PidController
from retuner.schedule.gains import PidGains

LAG_S, DEAD = 20.0, 5
PROCESS = LinearProcess(1.0, (LAG_S,), (), DEAD + 0.5)


def watched(gains: PidGains, samples: int, *, gap_every: int = 0) -> tuple[PidController, list[Decision]]:
    """A loop on a first-order lag with dead time, its output between limits, with loads; decisions in their order."""
    pid = PidController(gains, dt_s=1.0, pv_range=(0.0, 100.0), mode="auto")
    y, past, found = 40.0, [40.0] * DEAD, []
    keep = math.exp(-1.0 / LAG_S)
    for t in range(samples):
        noise = 0.05 * math.sin(t * 12.9898) * math.cos(t * 78.233)
        past.append(pid.step(45.0 if t > 100 else 40.0, y + noise, 20.0 if gap_every and t % gap_every == 0 else 1.0))
        y = keep * y + (1.0 - keep) * past.pop(0)
        found += [pid.decision] if pid.decision is not None else []
    return pid, found


@pytest.mark.slow
@pytest.mark.parametrize("gains", [PidGains(9.0, 0.9), PidGains(12.0, 0.2), PidGains(4.0, 1.6)])
def test_a_loop_that_every_model_calls_unstable_is_made_safer_by_the_second_record(gains: PidGains) -> None:
    assert math.isinf(sensitivity_peak(PROCESS, gains))
    pid, found = watched(gains, 1500)
    first = next(i for i, d in enumerate(found) if d.action is Action.WRITE)
    assert first <= 1
    assert sensitivity_peak(PROCESS, pid.gains) < 2.5
    assert not any("one load response is not enough" in d.reason for d in found[1:])


def test_gaps_between_which_nothing_is_complete_are_told_and_ever_more_seldom() -> None:
    _, found = watched(PidGains(1.8, 0.09), 2400, gap_every=30)
    told = [d for d in found if d.code == "broken_off"]
    assert told[0].reason.startswith("3 gaps of more than 8 sample times in a row")
    assert len(told) <= 2
    assert all(d.action is Action.NONE for d in told)
    _, quiet = watched(PidGains(1.8, 0.09), 2400)
    assert "broken_off" not in {d.code for d in quiet}


def test_the_count_of_responses_in_danger_is_kept_with_the_others() -> None:
    seen = Excitation(1, 2, 1, 0, 1, 2)
    assert seen.lost == 2
    assert seen.of_alternative().lost == 0
    with pytest.raises(ValueError, match="lost"):
        replace(seen, lost=-1)
