"""Whether a record is odd: does what is known go by it, or by all the others?

What is known moves by half of what one informative record says, or a process that changes would be followed too slowly.
So one record that was misread (a load of another shape, a beginning in motion, an output at its limit) turns a loop
that a dozen others hold for robust into one that is in danger. A record that contradicts waits for a second one; this
is asked of those that agree, but worse than the others did.

    odds = prior x  N(0, c^2 S) / N(0, S)  =  prior x exp(chi2 (1 - 1/c^2) / 2) / c^d

chi2 is the record's innovation in units of what records of this region usually have, S what was foretold, c how many
times farther an odd one lies (a contaminated normal: Tukey 1960; in a filter: Meinhold & Singpurwalla 1989). The usual
innovation is the median of the last ones and of two that are as large as foretold, so a region says it only by and by,
and odd ones do not count. Of what looks odd a share is the first record of a process that has changed.

Where a record is odd, what was known before it holds. What a set is expected to cost is weighed over both.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.choice.expected_cost import FARTHEST, Outlook
from retuner.adaptive.choice.settings import ChoiceSettings

AS_FORETOLD = 2
"""Records whose innovation is taken to be as foretold before any is seen."""


def oddness(innovation: float, before: Sequence[float], freedom: int, settings: ChoiceSettings) -> float:
    """Probability that a record is odd.

    Parameters
    ----------
    innovation : of the record, chi-square of `freedom` degrees. before : the same of the last records.
    """
    foretold = _median(freedom)
    usual = float(np.median([*before, *[foretold] * AS_FORETOLD]))
    chi2 = innovation * max(foretold / max(usual, settings.odd_least * foretold), 1.0)
    spread = settings.odd_spread
    exponent = chi2 * (1.0 - spread**-2) / 2.0 - freedom * math.log(spread)
    odds = settings.odd * math.exp(min(exponent, FARTHEST))
    return settings.odd_most * odds / (1.0 + odds)


def _median(freedom: int) -> float:
    """Of chi-square (Wilson & Hilferty 1931)."""
    return float(freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3)


def by_odds(now: Sequence[Outlook], before: Sequence[Outlook], odd: float) -> list[Outlook]:
    """What sets are expected to do where the newest record is odd with a probability.

    now : by all that is known. before : the same sets without the newest record. What is told of IAE and Ms stays that
    of all that is known.
    """
    return [
        replace(one, cost=(1.0 - odd) * one.cost + odd * without.cost) for one, without in zip(now, before, strict=True)
    ]
