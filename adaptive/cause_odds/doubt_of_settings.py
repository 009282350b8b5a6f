"""Do settings hold on the processes that a record allows under a load that wanders?

    P(Ms > limit) = sum over the grid of  p(process | record) [Ms(process, settings) > limit]

A model with a few load steps and a filter for the rest may explain a record by a process that is not there: lag, dead
time or an inverse response then stand for what a load that wanders does to pv. The exact likelihood of such a load
(explanations/wandering_load.py) weighs every process on the same record. If only parts of the record identify the
process, its settings must hold as settings by odds do (likely_processes.py), for the model is less sure.
"""

import math

import numpy as np

from retuner.adaptive.cause_odds.compared_records import compared
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.explanations.tuning_odds import tuning_odds
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains


def doubt_of_settings(window: Window, gains: PidGains, *, by_parts: bool = False) -> str:
    """Why settings that follow from one model do not hold under every load, in a sentence; empty where they do.

    window, gains : see share_over. by_parts : the model is that of parts of the record.
    """
    settings = OddsSettings()
    share = share_over(window, gains, settings.identified_ms, settings)
    if share <= (settings.worth.bad_share if by_parts else settings.identified_most):
        return ""
    return (
        "under a load that wanders other processes explain the record; these settings have Ms over "
        f"{settings.identified_ms:g} on {share:.0%} of them. Make a setpoint step."
    )


def share_over(window: Window, gains: PidGains, ms: float, settings: OddsSettings) -> float:
    """Share of the odds on which the gains have an Ms over this, 0 to 1; 0 where the record moves in nothing.

    window : in automatic. gains : asked about; their sign is the process gain's. ms : over it is every unstable loop.

    Raises ValueError: ms is no number above 1.
    """
    if not 1.0 < ms < math.inf:
        raise ValueError(f"ms = {ms} must be finite and over 1, where every loop begins")
    found = compared([window], gains, gains.direction, settings)
    if found is None:
        return 0.0
    odds = tuning_odds(np.sum(found.weighed, axis=0), gains, found.dt_s, settings.prior, settings.limits)
    return float(odds.weights[odds.robustness.ms > ms].sum())
