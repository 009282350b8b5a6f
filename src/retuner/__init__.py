"""retuner: gain scheduling and on-line adaptive PID.

    from retuner import Retuner, LoopSample, GainTable, PidGains, identify, tune

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from retuner.adaptive.decision import Decision as Decision
    from retuner.adaptive.margins import margins as margins
    from retuner.adaptive.performance import performance as performance
    from retuner.adaptive.process import LinearProcess as LinearProcess
    from retuner.adaptive.process import ProcessModel as ProcessModel
    from retuner.adaptive.process import ProcessType as ProcessType
    from retuner.adaptive.reduction import reduce as reduce
    from retuner.adaptive.retuner import Retuner as Retuner
    from retuner.adaptive.retuner_settings import RetunerSettings as RetunerSettings
    from retuner.adaptive.sample import LoopSample as LoopSample
    from retuner.api import identify as identify
    from retuner.config import load_config as load_config
    from retuner.conversions import gains_of as gains_of
    from retuner.conversions import process_of as process_of
    from retuner.conversions import to_control as to_control
    from retuner.conversions import to_scipy as to_scipy
    from retuner.schedule.gains import PidGains as PidGains
    from retuner.schedule.table import GainTable as GainTable
    from retuner.tuning import tune as tune

_HOMES = {
    "Decision": "adaptive.decision",
    "GainTable": "schedule.table",
    "LinearProcess": "adaptive.process",
    "LoopSample": "adaptive.sample",
    "PidGains": "schedule.gains",
    "ProcessModel": "adaptive.process",
    "ProcessType": "adaptive.process",
    "Retuner": "adaptive.retuner",
    "RetunerSettings": "adaptive.retuner_settings",
    "gains_of": "conversions",
    "identify": "api",
    "load_config": "config",
    "margins": "adaptive.margins",
    "performance": "adaptive.performance",
    "process_of": "conversions",
    "reduce": "adaptive.reduction",
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
