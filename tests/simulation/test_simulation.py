"""Host and device over a bus that does everything to them, from one seed: a small campaign, and the harness's teeth."""

import json
from collections import Counter
from functools import partial

import pytest
from bus_simulation import truth as t
from bus_simulation.campaign import BOX, FIRST, Campaign, World, run_seed
from bus_simulation.layers.door import Door
from bus_simulation.naive import NaiveWorld
from bus_simulation.truth import Order, Ran, Truth, ViolationError
from bus_simulation.weather import late
from effort import sized

from retuner.drivers.controller.gain_memory import GainPages, GainSet
from retuner.drivers.device import RunningSet, WriteDone, WriteFailed
from retuner.drivers.host.write_protocol import WriteProtocol
from retuner.drivers.protocol.frames import Kind, Reason
from retuner.schedule.gains import PidGains

STEPS = 700
OTHER = PidGains(2.0, 0.125, 0.5)


@pytest.mark.uncounted
@pytest.mark.parametrize("first", range(0, sized(10, 20, 40), 10))
def test_no_promise_is_broken(first: int) -> None:
    outcomes = [run_seed((seed, STEPS, "both")) for seed in range(first, first + 10)]

    assert [f"seed {o.seed}: {o.broken}" for o in outcomes if o.broken] == []
    total = sum((Counter(o.counts) for o in outcomes), Counter())
    assert total["faults"] > 3000
    assert total["done"] > 100
    assert total["host crashes"] > 10
    assert total["device crashes"] > 10
    assert total["intruder acts"] > 100


@pytest.mark.uncounted
@pytest.mark.parametrize("first", range(100, 100 + sized(10, 10, 20), 10))
def test_no_promise_is_broken_with_the_firmware_in_c(first: int) -> None:
    outcomes = [run_seed((seed, STEPS, "firmware")) for seed in range(first, first + 10)]
    assert [f"seed {o.seed}: {o.broken}" for o in outcomes if o.broken] == []
    total = sum((Counter(o.counts) for o in outcomes), Counter())
    assert total["done"] > 100
    assert total["device crashes"] > 10


def test_the_same_seed_is_the_same_run() -> None:
    def run() -> object:
        world = World(3)
        return world.run(300), world.truth.ran, [host.rows for host in world.hosts]

    assert run() == run()


@pytest.mark.parametrize("per_gain", [True, False])
def test_naive_protocols_fail_over_the_same_bus(per_gain: bool) -> None:
    counts = NaiveWorld(1, per_gain=per_gain).run(20_000)
    assert counts["running_set_is_a_committed_one"] > 100
    assert counts["finite_and_inside_the_box"] > 20


def seeds_until_broken(seeds: int = 40, device: str = "virtual") -> str:
    return next((o.broken for seed in range(seeds) if (o := run_seed((seed, STEPS, device))).broken), "")


@pytest.fixture
def only_what_comes_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """The invariants over all layers together must bite by themselves as well."""
    for name in ("came", "sampled", "restarted"):
        monkeypatch.setattr(Door, name, lambda *_, **__: None)


@pytest.mark.usefixtures("only_what_comes_of_all")
def test_a_device_that_does_not_fence_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bus_simulation.campaign.draw", late)
    monkeypatch.setattr(GainPages, "abort", lambda self, frame: self._ack(Kind.ABORT, frame.seq, Reason.OK))
    assert "failed_sets_stay_dead" in seeds_until_broken()


@pytest.mark.usefixtures("only_what_comes_of_all")
def test_a_device_that_does_not_check_the_base_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    judge = GainPages._judge

    def careless(self, frame, owner, code):
        running = self.running
        self.running = running._replace(seq=frame.base)
        try:
            return judge(self, frame, owner, code)
        finally:
            self.running = running

    monkeypatch.setattr(GainPages, "_judge", careless)
    assert seeds_until_broken() != ""


def test_a_host_that_believes_the_acknowledge_instead_of_reading_back_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    on_running = WriteProtocol.on_running

    def credulous(self, running):
        outcome = on_running(self, running)
        if isinstance(outcome, WriteFailed) and "no answer" in outcome.reason:
            return WriteDone(outcome.seq, outcome.running.gains, outcome.running)
        return outcome

    monkeypatch.setattr(WriteProtocol, "on_running", credulous)
    assert "done_is_what_was_ordered" in seeds_until_broken()


ORDER = Order(1, 1, 0, OTHER, 5, "host1")
SET = RunningSet(1, OTHER, 0)


TRUTH = Truth(Ran(0, 1, 0, FIRST), BOX, authentic=True, forged=False)
TRUTH.newest_swapped = 2
TRUTH.dead.add(OTHER)
BREACHES = [
    partial(t.running_set_is_a_committed_one, TRUTH, Ran(1, 1, 1, OTHER), 5),
    partial(t.built_on_what_ran, ORDER, Ran(0, 1, 7, FIRST)),
    partial(t.authentic, TRUTH, ORDER._replace(who="intruder")),
    partial(t.one_owner, ORDER, 6),
    partial(t.finite_and_inside_the_box, TRUTH, Ran(1, 1, 1, PidGains(50.0, 0.0625)), TRUTH.ran[0]),
    partial(t.finite_and_inside_the_box, TRUTH, Ran(1, 1, 1, PidGains(-1.0, -0.0625)), TRUTH.ran[0]),
    partial(t.sequence_is_monotonic, TRUTH, Ran(1, 1, 2, OTHER)),
    partial(t.failed_sets_stay_dead, TRUTH, Ran(1, 1, 1, OTHER)),
    partial(t.reverted_to_the_confirmed_set, TRUTH, Ran(1, 1, 1, OTHER)),
    partial(t.restarted_on_a_confirmed_set, TRUTH, Ran(1, 1, 1, OTHER)),
    partial(t.reported_is_what_ran, TRUTH, SET, 0),
    partial(t.done_is_what_was_ordered, WriteFailed(1, "", SET), ORDER),
    partial(t.ledger_has_the_intent, [], ORDER),
    partial(t.ledger_has_every_outcome, [("intent", OTHER)], 0),
    partial(t.time_goes_forward, 2.0, 2.0),
    partial(t.known_after_calm, connected=True, writing=False, running=SET, truth=TRUTH),
    partial(t.known_after_calm, connected=True, writing=True, running=SET, truth=TRUTH),
    partial(t.writes_succeed_in_calm, None),
]


@pytest.mark.parametrize("breach", BREACHES, ids=lambda breach: breach.func.__name__)
def test_every_invariant_can_fail(breach: partial) -> None:
    with pytest.raises(ViolationError, match=breach.func.__name__):
        breach()


def test_every_invariant_is_seen_to_fail() -> None:
    functions = {name for name, value in vars(t).items() if callable(value) and value.__module__ == t.__name__}
    assert functions - {"Order", "Ran", "Truth", "ViolationError", "restarted"} == {
        breach.func.__name__ for breach in BREACHES
    }


def test_a_torn_page_is_found() -> None:
    world = World(0)
    world.run(50)
    world.device.pages.running = GainSet(9999, OTHER)
    with pytest.raises(ViolationError, match="running_set_is_a_committed_one"):
        world.step()


def test_a_campaign_goes_on_where_it_was_stopped(tmp_path) -> None:
    state = tmp_path / "state.json"
    assert [o.seed for o in Campaign(0, 2, 50, state).run(1)] == [0, 1]
    again = Campaign(0, 3, 50, state)
    assert again.done == {0, 1}
    assert [o.seed for o in again.run(1)] == [2]
    assert again.counts["steps"] == 150
    kept = json.loads(state.read_text())
    state.write_text(json.dumps({**kept, "key": "of other code"}))
    newer = Campaign(0, 1, 50, state)
    assert (newer.done, newer.first) == (set(), 3)
    assert [o.seed for o in newer.run(1)] == [3]
    assert newer.steps_of_all() == 200
    assert Campaign(0, 2, 50, state).done == {3}
    assert [o.seed for o in Campaign(10, 4, 50, None, hours=0.0).run(1)] == [10]
