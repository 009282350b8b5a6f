"""Three explanations of one record, fitted with the same engine and compared by the same criterion.

    linear     pv = G co + load steps + random walk                          the loop's own doing, and ordinary upsets
    external   the same + a sinusoid with harmonics at a free frequency      an oscillation from outside
    stuck      the same with co replaced by the output of a stuck valve      see sticking.py

Harmonics belong to the second, because what comes from outside is often another loop's limit cycle, a triangle or a
saw, which one sinusoid leaves to the valve. What is left counts as it is, not whitened: even one real pole takes an
oscillation that is slow against the sampling for noise.
"""

from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.candidate import Candidate, Seen, judged
from retuner.adaptive.fit.choice import ChoiceSettings, candidates
from retuner.adaptive.fit.improve import improved
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.fit.structure import SLOPE
from retuner.adaptive.sample import Window

HARMONICS = 5
"""Of an outside oscillation: a triangle or a saw is told from its first five to two percent."""
WHITE = 0
"""Order of the filter for what is left: a filter would whiten any slow oscillation without naming its cause."""
WEAKENED = 3.0
"""The process is also tried with a gain e^-3 of the linear one: next to a tone it may have no part at all."""


def linear(window: Window, signs: tuple[int, ...], settings: ChoiceSettings, most_samples: int) -> list[Candidate]:
    """The linear explanation in every structure, best first."""
    return candidates(window, signs, settings, most_samples)


def external(fit: Candidate, frequencies: list[float], most_loads: int) -> Candidate:
    """The best explanation with a tone from outside.

    fit : the linear one. frequencies : where to look, rad/s.
    """
    found = []
    base = replace(fit.fit.misfit, harmonics=HARMONICS, ar=(), sigma=fit.fit.misfit.record.noise_std)
    plain = replace(base, loads=0, rounded=False)
    x = fit.fit.x
    weak = x.copy()
    weak[SLOPE] -= WEAKENED
    for w in frequencies:
        found.append(judged(refine(base, np.append(fit.fit.p, np.log(w)))))
        found += [judged(refine(plain, np.append(start, np.log(w)))) for start in (x, weak)]
    best = min(found, key=lambda c: c.criterion)
    return improved(best, most_loads, Seen(found))
