"""Write docs/developers/state-machines.md: every state machine as a diagram, drawn from the table in the code.

python scripts/document_machines.py
"""

from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from retuner.adaptive.experiments import phases as experiment
from retuner.adaptive.setpoint_bumps import bump_planner
from retuner.adaptive.signals import recogniser
from retuner.adaptive.trial import phase as trial
from retuner.drivers.host import can_device, write_protocol
from retuner.drivers.profiles import gain_course
from retuner.session import gain_writer, loop_session

PAGE = Path(__file__).resolve().parent.parent / "docs" / "developers" / "state-machines.md"
HEAD = """# State machines

Whatever has phases here has one enum of them, one enum of what can happen, and one table; these are the tables, drawn.
An arrow that is not there is an input that leaves the phase as it is. Where inputs lead the same way, one arrow carries
them all. This page is written by scripts/document_machines.py.
"""
TOGETHER = 5
"""More inputs than so many that lead the same way are named below the diagram, not on the arrow."""

Way = tuple[str, str, str]
"""From, by, to."""


class Machine(NamedTuple):
    """title, what it is about, where its table is, its first phase, and its ways in the order of the table."""

    title: str
    about: str
    table: str
    start: Enum
    ways: list[Way]


def ways(table: Mapping[tuple[Enum, Enum], Enum]) -> list[Way]:
    """Of a table by phase and input."""
    return [(old.name, event.name, new.name) for (old, event), new in table.items()]


def nested(table: Mapping[Enum, Mapping[Enum, Enum]]) -> list[Way]:
    """Of a table of tables."""
    return [(old.name, event.name, new.name) for old, row in table.items() for event, new in row.items()]


def matrix() -> list[Way]:
    """Of the recogniser's, which is a matrix of numbers; what stays where it is is left out."""
    phases, events = list(recogniser.RecogniserPhase), list(recogniser.Event)
    return [
        (old.name, event.name, recogniser.RecogniserPhase(new).name)
        for old, row in zip(phases, recogniser.TABLE, strict=True)
        for event, new in zip(events, row, strict=True)
        if new != old
    ]


MACHINES: tuple[Callable[[], Machine], ...] = (
    lambda: Machine(
        "The recogniser",
        "Finds the peaks of a response, sample by sample.",
        "adaptive/signals/recogniser.py",
        recogniser.RecogniserPhase.SETTLE,
        matrix(),
    ),
    lambda: Machine(
        "A change on trial",
        "Where a change of gains stands in its region.",
        "adaptive/trial/phase.py",
        trial.TrialPhase.IDLE,
        ways(trial.TRANSITIONS),
    ),
    lambda: Machine(
        "A setpoint bump",
        "Announced, sent, held until the loop is at rest, and removed; off until someone allows it.",
        "adaptive/setpoint_bumps/bump_planner.py",
        bump_planner.BumpPhase.WATCHING,
        ways(bump_planner.COURSE),
    ),
    lambda: Machine(
        "The session",
        "From the first sample to the end, where it is settled which gains stay after an undecided change.",
        "src/retuner/session/loop_session.py",
        loop_session.SessionPhase.WATCHING,
        ways(loop_session.COURSE),
    ),
    lambda: Machine(
        "The gain writer",
        "What is being written, and whether a decision waits for the wire.",
        "src/retuner/session/gain_writer.py",
        gain_writer.WriterPhase.IDLE,
        ways(gain_writer.WRITING),
    ),
    lambda: Machine(
        "The connection",
        "How far the host is with one controller.",
        "drivers/host/can_device.py",
        can_device.ConnectPhase.SEARCHING,
        ways(can_device.CONNECTION),
    ),
    lambda: Machine(
        "The two-phase write",
        "One write of a gain set over CAN.",
        "drivers/host/write_protocol.py",
        write_protocol.WritePhase.IDLE,
        ways(write_protocol.TRANSITIONS),
    ),
    lambda: Machine(
        "The write to a controller that is not ours",
        "One gain set, message by message, each read back before the next.",
        "drivers/profiles/gain_course.py",
        gain_course.CoursePhase.IDLE,
        ways(gain_course.COURSE),
    ),
    lambda: Machine(
        "An experiment on demand",
        "Every way out ends in the verified old state.",
        "adaptive/experiments/phases.py",
        experiment.Phase.CONNECTING,
        nested(experiment.TRANSITIONS),
    ),
)


def drawn(machine: Machine) -> str:
    """One machine as a section: a diagram in Mermaid's words, then the long labels."""
    arrows: dict[tuple[str, str], list[str]] = {}
    for old, event, new in machine.ways:
        arrows.setdefault((old, new), []).append(event)
    groups: dict[tuple[str, ...], str] = {}
    lines = [f"    [*] --> {machine.start.name}"]
    for (old, new), events in arrows.items():
        label = ", ".join(events)
        if len(events) > TOGETHER:
            label = groups.setdefault(tuple(events), f"any of {chr(ord('A') + len(groups))}")
        lines.append(f"    {old} --> {new}: {label}")
    diagram = "\n".join(["```mermaid", "stateDiagram-v2", *lines, "```"])
    named = "".join(f"\n{label.removeprefix('any of ')}: {', '.join(events)}.\n" for events, label in groups.items())
    return f"\n## {machine.title}\n\n{machine.about} Table: `{machine.table}`.\n\n{diagram}\n{named}"


def page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(drawn(machine()) for machine in MACHINES)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
