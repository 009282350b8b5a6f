"""From the configuration to the objects of the rooms, each made in one place."""

import math

from retuner.adaptive.decision import Mode
from retuner.adaptive.guard import GuardSettings
from retuner.adaptive.retuner import Retuner, RetunerSettings
from retuner.config import Config


def retuner_settings(config: Config, mode: Mode | None = None) -> RetunerSettings:
    """The retuner's settings; mode overrides the configured one."""
    a, loop = config.adaptation, config.loop
    guard = GuardSettings(
        ms_nominal=a.ms_nominal,
        ms_worst=a.ms_worst,
        tau_c_max_ratio=a.tau_c_max_ratio,
        step_up_max=a.step_up_max,
        step_down_max=a.step_down_max,
        kc_min=a.kc_min or 0.0,
        kc_max=math.inf if a.kc_max is None else a.kc_max,
    )
    return RetunerSettings(
        sample_time_s=loop.sample_time_s,
        pv_span=loop.pv_max - loop.pv_min,
        mode=mode or Mode(a.mode),
        band=a.noise_band,
        wait_s=a.wait_s,
        guard=guard,
    )


def make_retuner(config: Config, mode: Mode | None = None) -> Retuner:
    """A retuner that knows nothing yet, on the table as commissioned."""
    return Retuner(config.gain_table(), retuner_settings(config, mode))
