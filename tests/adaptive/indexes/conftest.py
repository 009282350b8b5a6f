"""Signals whose indexes are known."""

from collections.abc import Callable

import numpy as np
import pytest

PERIOD = 40.0  # Samples per period of the waves


def a_wave(kind: str, n: int = 1000, period: float = PERIOD, phase: float = 0.0) -> np.ndarray:
    """A wave of unit amplitude; phase as a share of a period."""
    s = (np.arange(n) / period + phase + 1e-4) % 1.0
    shapes = {
        "sine": np.sin(2 * np.pi * s),
        "triangle": 1 - 4 * np.abs((s + 0.25) % 1.0 - 0.5),
        "square": np.where(s < 0.5, 1.0, -1.0),
        "saw": 2 * s - 1,
    }
    return shapes[kind]


@pytest.fixture(scope="session")
def wave() -> Callable[..., np.ndarray]:
    return a_wave


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
