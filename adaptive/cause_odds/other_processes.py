"""Do settings hold on the processes that a record allows under a load that wanders?

    P(Ms > limit) = sum over the grid of  p(process | record) [Ms(process, settings) > limit]

A model with a few load steps and a filter for the rest may explain a record by a process that is not there: what a load
that wanders does to pv is bought as lag, dead time or an inverse response. The exact likelihood of such a load
(explanations/wandering_load.py) weighs every process on the same record.
"""

import math

import numpy as np

from retuner.adaptive.cause_odds.odds import interval_s, windows_of
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.explanations.process_grid import gain_unit
from retuner.adaptive.explanations.tuning_odds import tuning_odds
from retuner.adaptive.explanations.wandering_load import Prepared, log_likelihood
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains


def share_over(window: Window, gains: PidGains, ms: float) -> float:
    """Share of the odds on which the gains have an Ms over this, 0 to 1; 0 where the record moves in nothing.

    Parameters
    ----------
    window : the record in automatic. gains : the settings asked about; their sign is that of the process gain.
    ms : largest sensitivity, above 1; an unstable loop is over every limit.

    Raises
    ------
    ValueError
        ms is no number above 1.
    """
    if not 1.0 < ms < math.inf:
        raise ValueError(f"ms = {ms} must be finite and over 1, where every loop begins")
    settings = OddsSettings()
    dt = interval_s(window, settings)
    records = [Prepared.at(part, dt) for part in windows_of(window, dt, settings.most_windows)]
    moving = [record for record in records if np.ptp(record.pv) > 0 and np.ptp(record.co) > 0]
    if not moving:
        return 0.0
    unit = gain_unit(gains, dt)
    total = np.sum([log_likelihood(record, gains.direction, unit) for record in moving], axis=0)
    odds = tuning_odds(total, gains, dt, settings.prior, settings.limits)
    return float(odds.weights[odds.robustness.ms > ms].sum())
