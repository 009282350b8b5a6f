"""retuner beside a control loop of your own: asyncio, ten samples a second, gains that people change as well.

    python examples/own_loop.py                # two sessions of a simulated rig, 20 times as fast as real

Copy `watched`, and give it your device in place of `Rig`: `read` tells the next sample, `gains` what the device runs,
`write` gives it other gains without a bump. What it does:

- Nothing waits for a decision: it is made in another process, and comes with a later sample.
- What a decision asks for is done and told: `committed` after a change, `restored` after what was taken back.
- Gains that a person sets at the device are seen there, told by `edited`, and kept for a shift. Changes are proposed.
- A person may say "undo" (a change that is on trial) and "approve" (the newest proposal).
- What is known is in a file before anything changes, so a session may end at any moment; the next one goes on.
"""

import argparse
import asyncio
import json
import math
import random
import tempfile
from collections import deque
from contextlib import suppress
from pathlib import Path

from retuner import (
    Action,
    BackgroundRetuner,
    Decision,
    GainTable,
    LoopSample,
    PidGains,
    Regions,
    Retuner,
    RetunerSettings,
    TrialEvent,
    approve_proposal,
    found_running,
    remember,
    restore,
)

DT_S = 0.1
SETTINGS = RetunerSettings(sample_time_s=DT_S, pv_span=100.0, mode="auto")
COMMISSIONED = GainTable("rig", Regions("sp", "%", ("all",), 0.0, (), 100.0), (PidGains(kp=0.6, ki=0.2),))


async def good_sample(rig: "Rig") -> LoopSample:
    """The next sample in which all are numbers: one of a sensor that has failed counts as lost."""
    while True:
        sample = await rig.read()
        if all(map(math.isfinite, sample[:4])):
            return sample


async def watched(rig: "Rig", memory: Path, wishes: deque[str], watch: type = BackgroundRetuner) -> None:
    """Watch the rig and retune it until this is cancelled. wishes : what a person wants, "undo" or "approve"."""
    known = json.loads(memory.read_text()) if memory.exists() else None
    retuner = Retuner(COMMISSIONED, SETTINGS) if known is None else restore(known, SETTINGS)
    proposal: Decision | None = None

    def save() -> None:
        new = memory.with_suffix(".new")
        new.write_text(json.dumps(remember(retuner)))
        new.replace(memory)  # whole, or not at all

    def obey(decision: Decision | None) -> None:
        nonlocal proposal
        if decision is None:
            return
        save()  # before anything changes
        print(f"{decision.t_s:6.1f} s  {decision}")
        if decision.action == Action.WRITE and decision.gains_after is not None:
            # later: gains for a region where the loop is not; the table takes them, and nothing is written
            now = decision.gains_after if decision.later else rig.write(decision.gains_after)
            retuner.committed(retuner.table.index(decision.region), now)
        elif decision.action == Action.RESTORE and retuner.region is not None:
            rig.write(retuner.table.at(retuner.region, *retuner.scheduled))
            retuner.restored()
        proposal = decision if decision.action == Action.ADVISE else proposal
        save()

    with watch(retuner) as watcher:
        if known is not None:
            obey(found_running(retuner, rig.gains))  # did a write come about? has a person set others meanwhile?
        try:
            while True:
                sample = await good_sample(rig)
                obey(retuner.edited(rig.gains))  # None while the device runs what the table says
                obey(watcher.observe(sample))
                wish = wishes.popleft() if wishes else ""
                if wish == "undo" and retuner.region is not None:
                    obey(retuner.rolled_back(retuner.region))
                elif wish == "approve" and proposal is not None:
                    obey(approve_proposal(retuner, proposal))
        finally:
            obey(retuner.abort(TrialEvent.STOPPED))  # nobody watches from here on: what is to run?
            save()


class Rig:
    """A simulated device with a PI controller of its own: 2 e^-0.5s / (3 s + 1), its setpoint stepped every 30 s."""

    def __init__(self, gains: PidGains, speed: float) -> None:
        self.gains, self.t_s, self.pause_s = gains, 0.0, DT_S / speed
        self._pv, self._integral = 40.0, 20.0
        self._on_the_way = deque([20.0] * 5)
        self._noise = random.Random(1).gauss  # the same at every run

    def write(self, gains: PidGains) -> PidGains:
        """Run other gains; the output does not jump. Returns what runs, as read back."""
        self._integral += (self.gains.kp - gains.kp) * (self._setpoint - self._pv)
        self.gains = gains
        return self.gains

    @property
    def _setpoint(self) -> float:
        return 50.0 if self.t_s % 60.0 >= 30.0 else 40.0

    async def read(self) -> LoopSample:
        """The next sample."""
        await asyncio.sleep(self.pause_s)
        self.t_s = round(self.t_s + DT_S, 6)
        setpoint, measured = self._setpoint, self._pv + self._noise(0.0, 0.03)
        error = setpoint - measured
        self._integral += self.gains.ki * error * DT_S
        output = min(max(self.gains.kp * error + self._integral, 0.0), 100.0)
        self._on_the_way.append(output)
        self._pv += (2.0 * self._on_the_way.popleft() - self._pv) * DT_S / 3.0
        return LoopSample(self.t_s, setpoint, measured, output, x=setpoint)


async def session(
    rig: Rig, memory: Path, until_s: float, person: dict[float, str] | None = None, watch: type = BackgroundRetuner
) -> None:
    """Watch until a time of the rig, and end as by Ctrl-C. person : what he says, by times of the rig."""
    wishes, left = deque[str](), sorted((person or {}).items())
    task = asyncio.create_task(watched(rig, memory, wishes, watch))
    while rig.t_s < until_s and not task.done():
        await asyncio.sleep(rig.pause_s)
        if left and rig.t_s >= left[0][0]:
            wishes.append(left.pop(0)[1])
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task
    print(f"{rig.t_s:6.1f} s  nobody watches: {rig.gains}")


async def main(speed: float, memory: Path) -> None:
    """A session; then a person sets gains; and another session, where he approves what is proposed, and regrets it."""
    rig = Rig(COMMISSIONED.gains_of(0), speed)
    await session(rig, memory, 95.0)
    rig.write(PidGains(kp=0.7, ki=0.25))
    await session(rig, memory, 230.0, {205.0: "approve", 208.0: "undo"})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--speed", type=float, default=20.0, help="times real time (20)")
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(main(parser.parse_args().speed, Path(folder) / "rig.json"))
