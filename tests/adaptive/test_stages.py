"""A decision runs through the steps that the documentation tells, in its order."""

import re
import sys
from pathlib import Path
from types import FrameType

from loop_bench import Bench, scaled, table

from retuner.adaptive.supervision.decision import Action, Mode
from retuner.adaptive.supervision.findings import STEPS
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings

PAGE = Path(__file__).resolve().parents[2] / "docs" / "developers" / "how-it-works.md"
ROOM = "/adaptive/supervision/"


def told() -> list[str]:
    """Names of the steps, as documented."""
    text = PAGE.read_text().split("| step | asks | in |")[1].split("\n\n")[0]
    return re.findall(r"^\| ([a-z ]+) \| .+\? \| `[a-z_]+\.py` \|$", text, flags=re.MULTILINE)


def test_a_decision_runs_through_the_steps_that_the_documentation_tells_in_its_order() -> None:
    names, ran = told(), list[str]()

    def noted(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_name.replace("_", " ")
        if event == "call" and ROOM in frame.f_code.co_filename and name in names and name not in ran:
            ran.append(name)

    bench = Bench(Retuner(table(scaled(0.4, 0.4)), RetunerSettings(1.0, 10.0, Mode.AUTO)), seed=2)
    bench.run(400)
    before = sys.getprofile()
    sys.setprofile(noted)
    try:
        made = bench.run(500, 1.0)
    finally:
        sys.setprofile(before)
    assert made[0].action is Action.WRITE
    assert ran == [name for name in names if name in ran]
    assert set(names) - set(ran) <= {"objection", "proposal by all samples"}  # where there is a book by then


def test_the_documentation_begins_with_the_steps_of_the_findings() -> None:
    assert told()[: len(STEPS)] == [step.__name__.replace("_", " ") for step in STEPS]
