"""Helpers of this folder."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from served import Served, Session


@pytest.fixture
def browsers(tmp_path: Path) -> Iterator[Callable[..., object]]:
    """Windows of a real browser (chromium.py), which is loaded for those tests only."""
    from chromium import windows

    with windows(tmp_path) as opened:
        yield opened


@pytest.fixture
def session(tmp_path: Path) -> "Iterator[Session]":
    from served import Session

    made = Session(tmp_path / "demo")
    made.samples(30)
    yield made
    made.close()


@pytest.fixture
def served(session: "Session") -> "Iterator[Served]":
    from served import Served

    made = Served(session.folder.parent)
    made.look()
    yield made
    made.close()
