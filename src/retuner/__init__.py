"""retuner: gain scheduling and on-line adaptive PID.

    from retuner import Retuner, LoopSample, GainTable, PidGains, identify, diagnose, tune

Names are loaded when they are first used, so that importing the package costs nothing.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

from retuner.adaptive.fit import engine

if TYPE_CHECKING:
    from retuner.adaptive.loop.margins import margins as margins
    from retuner.adaptive.loop.performance import performance as performance
    from retuner.adaptive.process.model import LinearProcess as LinearProcess
    from retuner.adaptive.process.model import ProcessModel as ProcessModel
    from retuner.adaptive.process.model import ProcessType as ProcessType
    from retuner.adaptive.process.reduction import reduce as reduce
    from retuner.adaptive.signals.sample import LoopSample as LoopSample
    from retuner.adaptive.supervision.decision import Decision as Decision
    from retuner.adaptive.supervision.retuner import Retuner as Retuner
    from retuner.adaptive.supervision.settings import RetunerSettings as RetunerSettings
    from retuner.api import diagnose as diagnose
    from retuner.api import identify as identify
    from retuner.api import read as read
    from retuner.config import load_config as load_config
    from retuner.conversions import gains_of as gains_of
    from retuner.conversions import process_of as process_of
    from retuner.conversions import to_control as to_control
    from retuner.conversions import to_scipy as to_scipy
    from retuner.decisions.background import BackgroundRetuner as BackgroundRetuner
    from retuner.schedule.gains import PidGains as PidGains
    from retuner.schedule.table import GainTable as GainTable
    from retuner.scheduling import design_schedule as design_schedule
    from retuner.tuning import tune as tune

engine.prefer(os.environ.get(engine.VARIABLE, "auto"))

_HOMES = {
    "BackgroundRetuner": "decisions.background",
    "Decision": "adaptive.supervision.decision",
    "GainTable": "schedule.table",
    "LinearProcess": "adaptive.process.model",
    "LoopSample": "adaptive.signals.sample",
    "PidGains": "schedule.gains",
    "ProcessModel": "adaptive.process.model",
    "ProcessType": "adaptive.process.model",
    "Retuner": "adaptive.supervision.retuner",
    "RetunerSettings": "adaptive.supervision.settings",
    "design_schedule": "scheduling",
    "diagnose": "api",
    "gains_of": "conversions",
    "identify": "api",
    "read": "api",
    "load_config": "config",
    "margins": "adaptive.loop.margins",
    "performance": "adaptive.loop.performance",
    "process_of": "conversions",
    "reduce": "adaptive.process.reduction",
    "to_control": "conversions",
    "to_scipy": "conversions",
    "tune": "tuning",
}

__all__ = sorted(_HOMES)  # noqa: PLE0605  one list of names, not two that drift apart


def __getattr__(name: str) -> object:
    """Load a public name from its home."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted(_HOMES)
