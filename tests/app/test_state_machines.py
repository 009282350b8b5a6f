"""The state machines of drivers and session: their page is their tables; no phase is a trap; misuse is counted."""

import re
import runpy
from enum import Enum
from pathlib import Path

import pytest

from retuner.drivers.host.can_device import CONNECTION, ConnectInput, ConnectPhase
from retuner.drivers.profiles.gain_course import COURSE as GAIN_COURSE
from retuner.drivers.profiles.gain_course import CourseInput, CoursePhase
from retuner.drivers.state_machine import StateMachine
from retuner.session.gain_writer import WRITING, WriterInput, WriterPhase
from retuner.session.loop_session import COURSE, SessionInput, SessionPhase

ROOT = Path(__file__).resolve().parents[2]
TABLES = [
    (CONNECTION, ConnectPhase, ConnectInput, set()),
    (GAIN_COURSE, CoursePhase, CourseInput, set()),
    (WRITING, WriterPhase, WriterInput, set()),
    (COURSE, SessionPhase, SessionInput, {SessionPhase.SETTLED, SessionPhase.LEFT_OPEN}),
]


def test_the_page_shows_what_the_tables_say() -> None:
    page = runpy.run_path(str(ROOT / "scripts" / "document_machines.py"))["page"]()
    assert (ROOT / "docs" / "developers" / "state-machines.md").read_text() == page, (
        "run: python scripts/document_machines.py"
    )
    for table, *_ in TABLES:
        for (old, event), new in table.items():
            assert re.search(rf"    {old.name} --> {new.name}: .*\b{event.name}\b", page)


@pytest.mark.parametrize(
    ("table", "phases", "inputs", "ends"), TABLES, ids=["connection", "course", "writer", "session"]
)
def test_every_phase_is_reached_and_left_and_every_input_leads_somewhere(table, phases, inputs, ends) -> None:
    start = next(iter(phases))
    reached = {start}
    while more := {new for (old, _), new in table.items() if old in reached} - reached:
        reached |= more
    assert reached == set(phases)
    assert {old for old, _ in table} == set(phases) - ends
    assert {event for _, event in table} == set(inputs)


class Lamp(Enum):
    OFF = 0
    ON = 1


class Switch(Enum):
    PRESS = 0
    RELEASE = 1


def test_what_the_table_does_not_name_changes_nothing_and_is_counted() -> None:
    machine = StateMachine({(Lamp.OFF, Switch.PRESS): Lamp.ON}, Lamp.OFF)
    assert not machine.take(Switch.RELEASE)
    assert machine.phase is Lamp.OFF
    assert machine.take(Switch.PRESS)
    assert not machine.take(Switch.PRESS)
    assert machine.phase is Lamp.ON
    assert machine.ignored == {(Lamp.OFF, Switch.RELEASE): 1, (Lamp.ON, Switch.PRESS): 1}
