"""A small trace of a signal in a line of characters."""

from collections.abc import Sequence

BARS = "▁▂▃▄▅▆▇█"
PLAIN = "_.-=*#"
"""For terminals that show ASCII only."""


def trace(values: Sequence[float], width: int, marks: str = BARS) -> str:
    """The values from left to right in so many characters: each column shows the mean of its share."""
    if width < 1 or not values:
        return ""
    columns = [_share(values, i, width) for i in range(min(width, len(values)))]
    low, high = min(columns), max(columns)
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-9):
        return marks[0] * len(columns)
    top = len(marks) - 1
    return "".join(marks[round(top * (value - low) / (high - low))] for value in columns)


def _share(values: Sequence[float], i: int, width: int) -> float:
    """Mean of the i-th of so many equal shares."""
    count = min(width, len(values))
    part = values[len(values) * i // count : len(values) * (i + 1) // count]
    return sum(part) / len(part)
