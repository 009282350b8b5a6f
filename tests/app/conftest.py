"""What several files of these tests begin with."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

sys.path.insert(0, str(Path(__file__).parent))

if TYPE_CHECKING:
    from wire import Wire


@pytest.fixture
def make_wire() -> "Iterator[Callable[..., Wire]]":
    """Sessions on the whole stack, closed at the end."""
    from wire import Wire

    made: list[Wire] = []

    def make(**arguments: object) -> Wire:
        made.append(Wire(**arguments))
        return made[-1]

    yield make
    for wire in made:
        wire.close()
