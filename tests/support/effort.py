"""How hard the tests try: one of three efforts, chosen by the environment variable RETUNER_TESTS.

| effort | run by | examples of hypothesis | samples | tests marked slow | nightly |
|---|---|---|---|---|---|
| quick (default) | make test | a fifth, the same every time | small | left out | left out |
| ci | .ci/run | a fifth, the same every time | full | run | left out |
| nightly | make nightly | ten times as many, others every time | full, or more | run | run |

Files and tests that are named on the command line are run whatever their mark.
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import TypeVar

from hypothesis import HealthCheck, settings

Size = TypeVar("Size")
One = TypeVar("One")
Other = TypeVar("Other")
VARIABLE = "RETUNER_TESTS"


@dataclass(frozen=True)
class Effort:
    """One of the three.

    Parameters
    ----------
    name : as the variable says it.
    examples : share of the examples that a test asks hypothesis for.
    marks : pytest's -m for the whole suite.
    derandomize : the same examples every time: a failure tells of a change and not of luck, which the nightly tries.
    """

    name: str
    examples: float
    marks: str
    derandomize: bool


EFFORTS = {
    effort.name: effort
    for effort in (
        Effort("quick", 0.2, "not slow and not nightly", derandomize=True),
        Effort("ci", 0.2, "not nightly", derandomize=True),
        Effort("nightly", 10.0, "", derandomize=False),
    )
}
EXAMPLES = 100  # Of a test that says no number, at full share
LEAST_EXAMPLES = 5

_chosen = os.environ.get(VARIABLE) or "quick"
if _chosen not in EFFORTS:
    raise SystemExit(f"{VARIABLE} = {_chosen}: give one of {', '.join(EFFORTS)}")
EFFORT = EFFORTS[_chosen]


def examples(count: int) -> int:
    """How many examples hypothesis tries where a test wants so many."""
    return max(min(count, LEAST_EXAMPLES), round(count * EFFORT.examples))


def sized(quick: Size, ci: Size, nightly: Size | None = None) -> Size:
    """A sample's size by effort; the nightly takes CI's where it has none of its own."""
    sizes = {"quick": quick, "ci": ci, "nightly": ci if nightly is None else nightly}
    return sizes[EFFORT.name]


def pairs(first: Iterable[One], second: Iterable[Other]) -> list[tuple[One, Other]]:
    """Each of the first with each of the second; quick: with every third of them, so that all of both are tried."""
    each = product(enumerate(first), enumerate(second))
    return [(one, other) for (i, one), (j, other) in each if (i + j) % sized(3, 1) == 0]


def load_profile() -> None:
    """Tell hypothesis. No deadline and no complaint about slow drawing: the machines are shared and noisy."""
    settings.register_profile(
        EFFORT.name,
        max_examples=examples(EXAMPLES),
        derandomize=EFFORT.derandomize,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
        print_blob=True,
    )
    settings.load_profile(EFFORT.name)
