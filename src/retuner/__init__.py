"""retuner: gain scheduling and on-line adaptive PID.

    import retuner

    record = retuner.read("loop.csv")
    print(retuner.diagnose(record))                    # the cause of its behaviour
    print(retuner.identify(record))                    # the process, and settings that follow
    pid = retuner.PidController(...)                   # a PID controller that retunes itself

Names are loaded when they are first used, so that importing the package costs nothing. Everything is logged under
"retuner", and nothing is shown unless a handler is added: logging.basicConfig(level="INFO") shows it.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

from retuner.adaptive import display_hook
from retuner.adaptive.fit import engine

if TYPE_CHECKING:
    from retuner.adaptive.loop.margins import margins
    from retuner.adaptive.loop.performance import performance
    from retuner.adaptive.orders.operator_orders import approve_proposal, found_running
    from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
    from retuner.adaptive.process.reduction import reduce
    from retuner.adaptive.signals.sample import LoopMode, LoopSample
    from retuner.adaptive.supervision.decision import Action, Decision, Mode
    from retuner.adaptive.supervision.retuner import Retuner
    from retuner.adaptive.supervision.retuner_settings import RetunerSettings
    from retuner.adaptive.supervision.state_file import remember, restore
    from retuner.adaptive.trial.phase import TrialEvent
    from retuner.api import Identification, identify, read
    from retuner.config import load_config
    from retuner.conversions import gains_of, process_of, to_control, to_scipy
    from retuner.decisions.background import BackgroundRetuner
    from retuner.diagnosing import RecordDiagnosis, diagnose
    from retuner.pid_controller import PidController
    from retuner.schedule.controller_units import Acting, ControllerUnits
    from retuner.schedule.gains import PidGains, to_ideal, to_series
    from retuner.schedule.regions import Axis, Regions
    from retuner.schedule.table import GainTable, Lookup
    from retuner.scheduling import design_schedule
    from retuner.simulation.loop_trend import LoopTrend
    from retuner.simulation.simulate_loop import simulate
    from retuner.tuning import TuneResult, tune

    __version__: str

__all__ = [
    "Acting", "Action", "Axis", "BackgroundRetuner", "ControllerUnits", "Decision", "GainTable", "Identification",
    "LinearProcess", "Lookup", "LoopMode", "LoopSample", "LoopTrend", "Mode", "PidController", "PidGains",
    "ProcessModel", "ProcessType", "RecordDiagnosis", "Regions", "Retuner", "RetunerSettings", "TrialEvent",
    "TuneResult", "approve_proposal", "design_schedule", "diagnose", "found_running", "gains_of", "identify",
    "load_config", "margins", "performance", "process_of", "read", "reduce", "remember", "restore", "simulate",
    "to_control", "to_ideal", "to_scipy", "to_series", "tune",
]  # fmt: skip

_HOMES = {
    "adaptive.loop.margins": ("margins",),
    "adaptive.loop.performance": ("performance",),
    "adaptive.process.model": ("LinearProcess", "ProcessModel", "ProcessType"),
    "adaptive.process.reduction": ("reduce",),
    "adaptive.signals.sample": ("LoopMode", "LoopSample"),
    "adaptive.supervision.decision": ("Action", "Decision", "Mode"),
    "adaptive.orders.operator_orders": ("approve_proposal", "found_running"),
    "adaptive.supervision.retuner": ("Retuner",),
    "adaptive.supervision.retuner_settings": ("RetunerSettings",),
    "adaptive.supervision.state_file": ("remember", "restore"),
    "adaptive.trial.phase": ("TrialEvent",),
    "api": ("Identification", "identify", "read"),
    "diagnosing": ("RecordDiagnosis", "diagnose"),
    "config": ("load_config",),
    "conversions": ("gains_of", "process_of", "to_control", "to_scipy"),
    "decisions.background": ("BackgroundRetuner",),
    "pid_controller": ("PidController",),
    "schedule.controller_units": ("Acting", "ControllerUnits"),
    "schedule.gains": ("PidGains", "to_ideal", "to_series"),
    "schedule.regions": ("Axis", "Regions"),
    "schedule.table": ("GainTable", "Lookup"),
    "scheduling": ("design_schedule",),
    "simulation.loop_trend": ("LoopTrend",),
    "simulation.simulate_loop": ("simulate",),
    "tuning": ("TuneResult", "tune"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

engine.prefer(os.environ.get(engine.VARIABLE, "auto"))
display_hook.shown_by("retuner.commands.recorded.notebook", import_module)

if not TYPE_CHECKING:  # a type checker knows the names from above, and refuses any other

    def __getattr__(name: str) -> object:
        """Load a public name from its home."""
        if name == "__version__":
            from importlib.metadata import version  # noqa: PLC0415  slow to load

            return version("retuner")
        if name not in _HOME_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*__all__, "__version__"])
