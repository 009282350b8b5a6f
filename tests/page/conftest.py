"""Helpers of this folder."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest


@pytest.fixture
def browsers(tmp_path: Path) -> Iterator[Callable[..., object]]:
    """Windows of a real browser (chromium.py), which is loaded for those tests only."""
    from chromium import windows

    with windows(tmp_path) as opened:
        yield opened
