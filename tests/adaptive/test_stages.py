"""The stages of the pipeline are those that the documentation tells, in its order."""

import re
from pathlib import Path

from retuner.adaptive.supervision.pipeline import STAGES

PAGE = Path(__file__).resolve().parents[2] / "docs" / "developers" / "how-it-works.md"


def test_the_documentation_lists_the_stages_as_they_run() -> None:
    table = PAGE.read_text().split("| stage | asks |")[1].split("\n\n")[0]
    told = re.findall(r"^\| ([a-z ]+) \| .+\? \|$", table, flags=re.MULTILINE)
    assert tuple(told) == tuple(stage.name for stage in STAGES)


def test_diagnosis_comes_before_tuning_and_proof_before_promise() -> None:
    names = [stage.name for stage in STAGES]
    order = ["admission", "swing", "identification", "hidden cause", "cause", "proof", "expectation"]
    assert sorted(names, key=names.index) == names
    assert [name for name in names if name in order] == order
    assert [stage.always for stage in STAGES] == sorted(stage.always for stage in STAGES)
