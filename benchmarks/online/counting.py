"""Counts with their uncertainty."""

from cases.counting import interval
from scipy.stats import beta

CONFIDENCE = 0.95


def counted(hits: int, n: int) -> str:
    """hits of n, the share, and its 95 % interval (Wilson)."""
    if n == 0:
        return "none"
    low, high = interval(hits, n)
    return f"{hits:4d} of {n:4d}  {hits / n:6.1%}  [{low:.1%}, {high:.1%}]"


def at_most(events: int, n: int) -> float:
    """Upper end of the exact two-sided 95 % interval of a share (Clopper & Pearson 1934); 1 - 0.025^(1/n) for none."""
    return 1.0 if events >= n else float(beta.ppf(1 - (1 - CONFIDENCE) / 2, events + 1, n - events))
