"""A fit repeated with what is known already as a prior: the iterated extended Kalman update (Bell & Cathey 1993).

    minimise  |r(p)|^2 + |root x - target|^2

The configuration (loads, drift, whitening) is that of the record's own fit. With the prior in it from the beginning, a
record of another process would have its misfit whitened away instead of being found odd.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.candidate import Candidate, judged
from retuner.adaptive.fit.refine import EXACT, Fit, Prior, refine
from retuner.adaptive.fit.structure import SIZE
from retuner.adaptive.process import ProcessType

Priors = Mapping[ProcessType, Prior]


def with_priors(
    found: list[Candidate], priors: Priors, inflation: Callable[[Fit], float] | None = None
) -> list[Candidate]:
    """The candidates of structures with a prior, refitted with it, best first.

    inflation : factor by which a fit's residuals count for less than their number (correlated, or unexplained): what a
        structure does not explain must not outvote what is known.
    """
    return sorted(
        (
            with_prior(c, priors[c.fit.misfit.type], 1.0 if inflation is None else inflation(c.fit))
            for c in found
            if c.fit.misfit.type in priors
        ),
        key=lambda c: c.criterion,
    )


def with_prior(alone: Candidate, prior: Prior, inflation: float = 1.0) -> Candidate:
    """One fit, started from its own optimum and from the prior's."""
    misfit, p = replace(alone.fit.misfit, sigma=alone.fit.misfit.sigma * inflation), alone.fit.p
    starts = (p, np.concatenate([prior.mean, p[SIZE[misfit.type] :]]))
    fits = [refine(misfit, start, prior, enough=EXACT) for start in starts]
    return judged(min(fits, key=lambda fit: fit.deviance), prior)
