"""A session that dies in the middle of a write: the next one looks what runs before it writes anything."""

import json
from collections.abc import Iterator

import pytest
from wire import GOOD, Wire

from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial.phase import TrialPhase
from retuner.drivers.protocol.checksum import to_wire
from retuner.schedule.gains import PidGains

P = TrialPhase
UNSTABLE = PidGains(6 * GOOD.kp, 6 * GOOD.ki)


@pytest.fixture
def died() -> Iterator[Wire]:
    """Its memory was written when the cure had been decided; what came after it is lost."""
    wire = Wire(low=UNSTABLE)
    wire.know()
    wire.ask(GOOD)
    yield wire
    wire.close()


def begin_again(wire: Wire, memory: dict[str, object]) -> None:
    """The next session, by its retuner: nothing else of the one before is known."""
    retuner = restore(json.loads(json.dumps(memory)), wire.session.retuner.settings)
    wire.session.retuner = wire.session.writer.retuner = retuner
    wire.session.writer._pending = None
    assert retuner.trials.phase(0) is P.WRITING


def test_a_cure_that_came_through_is_on_trial_again(died: Wire) -> None:
    memory = remember(died.session.retuner)
    died.until(P.TRIAL)
    assert died.runs == to_wire(GOOD)
    begin_again(died, memory)
    for _ in range(20):
        died.run(1)
        assert died.runs == to_wire(GOOD)
    assert died.trials.phase(0) is P.TRIAL
    assert to_wire(died.session.table.gains_of(0)) == to_wire(GOOD)


def test_one_that_came_through_after_it_was_given_up_stays(died: Wire) -> None:
    memory = remember(died.session.retuner)
    died.until(P.TRIAL)
    begin_again(died, memory)
    died.heard = lambda message: False  # noqa: ARG005
    died.run(8)
    died.heard = lambda message: True  # noqa: ARG005
    died.run(60)
    assert died.runs == to_wire(GOOD)
    assert died.trials.phase(0) is P.TRIAL


def test_what_did_not_come_through_is_told_and_nothing_is_written(died: Wire) -> None:
    memory = remember(died.session.retuner)
    died.asked.clear()
    begin_again(died, memory)
    died.run(20)
    assert died.runs == to_wire(UNSTABLE)
    assert died.trials.phase(0) is P.IDLE
    assert "in the middle of it" in str(dict(died.rows)["dropped"]["reason"])
