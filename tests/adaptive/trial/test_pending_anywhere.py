"""A whole retuner with changes under way where the loop is and where it is not, interrupted by anything at any moment.

Causes, samples of every kind, restarts from memory, a person's edit, late and lost writes come in any order. What the
table has for each region afterwards is never less robust, on the models allowed, than what it had before: of a region
without records these are the models that the others lend, on which its gains were proved.
"""

import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.region_model.from_neighbours import spread
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.supervision.known_processes import KnownProcesses, known_of
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial import rollback
from retuner.adaptive.trial.phase import SILENT, UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import predict
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

REGIONS = Regions("pv", "-", ("a", "b", "c"), 0.0, (30.0, 70.0), 100.0)
PLACES = (15.0, 50.0, 85.0)
SETTINGS = RetunerSettings(1.0, 100.0, Mode.AUTO)
HARMLESS = SETTINGS.trial.harmless_ms
LOG = LogModel(np.log([0.02, 5.0, 50.0]), 1e-4 * np.eye(3), 1)
KNOWN = RegionModel((StructureModel(LOG, 0.0),), 3, 0.0, plausible=spread(LOG))
RIGHT = simc(LOG.model().seen_by_controller(1.0)).gains
FACTORS = (0.25, 1.0, 2.2, 8.0)
"""Sluggish, right, swinging, unstable."""


def times(factor: float) -> PidGains:
    return PidGains(RIGHT.kp * factor, RIGHT.ki * factor)


class World:
    """The retuner and its controller; c has no records."""

    def __init__(self, before: tuple[float, ...]) -> None:
        self.retuner = Retuner(GainTable("loop", REGIONS, tuple(times(each) for each in before)), SETTINGS)
        self.retuner.region_models = {0: KNOWN, 1: KNOWN}
        self.t_s, self.at, self.chosen = 0.0, 0, False
        """chosen : the last thing was somebody's choice, or a write that came through."""
        self.sample()

    def sample(self, elapsed_s: float = 1.0, mode: LoopMode = LoopMode.AUTO, limited: int = 0) -> None:
        self.t_s += elapsed_s
        pv = PLACES[self.at]
        self.retuner.step(LoopSample(self.t_s, pv, pv, 0.0, mode, limited, pv))

    def go(self, region: int) -> None:
        self.at = region
        self.sample()

    def asks(self, region: int, factor: float) -> None:
        """A change is written there, as far as another does not forbid it; it is read back later, or never."""
        trials, old, new = self.retuner.trials, self.retuner.table.gains_of(region), times(factor)
        if old != new and trials.may_change(region, self.t_s):
            models = KNOWN.plausible
            trials.begin(region, old, new, predict(models, old, new, 1.0), self.t_s)

    def written(self, region: int) -> None:
        trial = self.retuner.trials.of(region)
        if trial.new is not None and trial.phase is TrialPhase.WRITING:
            self.chosen = True
            self.retuner.committed(region, trial.new)

    def lost(self, region: int) -> None:
        self.retuner.not_written(region)

    def restart(self) -> None:
        self.retuner = restore(json.loads(json.dumps(remember(self.retuner))), SETTINGS)

    def edited(self) -> None:
        self.chosen = True
        self.retuner.edited(times(1.3))


def cause(event: TrialEvent) -> Callable[[World], object]:
    return lambda world: world.retuner.abort(event)


HAPPENS: dict[str, Callable[[World], object]] = {
    **{event.name: cause(event) for event in SILENT},
    **{f"go to {name}": lambda world, i=i: world.go(i) for i, name in enumerate("abc")},
    **{f"{name} x {f:g}": lambda world, i=i, f=f: world.asks(i, f) for i, name in enumerate("abc") for f in FACTORS},
    **{f"{name} written": lambda world, i=i: world.written(i) for i, name in enumerate("abc")},
    **{f"{name} lost": lambda world, i=i: world.lost(i) for i, name in enumerate("abc")},
    "restart": World.restart,
    "restored": lambda world: world.retuner.restored(),
    "edited": World.edited,
    "sample": World.sample,
    "manual": lambda world: world.sample(mode=LoopMode.MANUAL),
    "gap": lambda world: world.sample(elapsed_s=500.0),
    "limit": lambda world: [world.sample(elapsed_s=20.0, limited=1) for _ in range(8)],
    "long after": lambda world: world.sample(elapsed_s=1e6),
}


def robustness(world: World, region: int, gains: PidGains) -> tuple[int, float]:
    known = known_of(KnownProcesses(world.retuner.table, world.retuner.region_models, world.t_s, SETTINGS), region)
    assert known.processes
    greatest, unstable = rollback.robustness(known.ms(gains))
    return unstable, max(greatest, HARMLESS)


def do(world: World, name: str) -> None:
    """One thing, and what the table has then is held against what it had."""
    before, world.chosen = world.retuner.table, False
    undecided = {at for at in range(3) if world.retuner.trials.phase(at) in UNDECIDED}
    HAPPENS[name](world)
    for region in range(3):
        was, now = before.gains_of(region), world.retuner.table.gains_of(region)
        if now == was or world.chosen:
            continue
        assert region in undecided, f"{name}: {REGIONS.names[region]} was not on trial"
        assert robustness(world, region, now) <= robustness(world, region, was), f"{name}: {was} -> {now}"


@pytest.mark.uncounted
@settings(max_examples=examples(100), deadline=None)
@given(
    st.tuples(*[st.sampled_from(FACTORS)] * 3),
    st.sampled_from("abc"),
    st.sampled_from(FACTORS),
    st.lists(st.sampled_from(sorted(HAPPENS)), min_size=3, max_size=10),
)
def test_what_runs_is_never_less_robust_after_anything(
    before: tuple[float, ...], region: str, factor: float, names: list[str]
) -> None:
    world = World(before)
    for name in (f"{region} x {factor:g}", f"{region} written", *names):
        do(world, name)


def test_gains_for_a_region_without_records_stay_where_those_before_are_unstable() -> None:
    """An interruption before the loop has ever come says nothing of them."""
    for event in SILENT:
        world = World((1.0, 1.0, 8.0))
        for name in ("c x 1", "c written", event.name, "restored", "go to c"):
            do(world, name)
        assert world.retuner.table.gains_of(2) == times(1.0), event
        ms = known_of(KnownProcesses(world.retuner.table, world.retuner.region_models, world.t_s, SETTINGS), 2).ms(
            times(8.0)
        )
        assert all(map(math.isinf, ms))
