"""retuner experiment step|setpoint|relay CONFIG: on demand against a controller, with limits, restored afterwards."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from retuner.adaptive.experiments.plan import Kind, Plan
from retuner.commands.run import RunOptions, overridden
from retuner.config import Config, load_config
from retuner.drivers.device import DeviceError
from retuner.errors import UserError, user_input
from retuner.experiment.findings import Question
from retuner.experiment.on_demand import OnDemandExperiment
from retuner.experiment.result import RECORD
from retuner.experiment.runner import Bench
from retuner.experiment.target import DEFAULT_DEVIATION, DEFAULT_SAMPLES, DEFAULT_SHARE, REST_WAIT_SAMPLES
from retuner.ledger import Ledger
from retuner.report.console import RunScreen, screen_console
from retuner.session.assembly import make_plant
from retuner.session.bench import live, simulated
from retuner.session.outputs import BUS_LOG, LEDGER, fresh_folder, give_back
from retuner.session.running import real_time_speed
from retuner.stopping import stoppable


@dataclass(frozen=True, slots=True)
class OnDemand:
    """Options; None leaves the default. Amplitude in co percent (setpoint: pv units), times in seconds."""

    interface: str | None = None
    channel: str | None = None
    speed: str = "max"
    out: Path | None = None
    yes: bool = False
    as_json: bool = False
    amplitude: float | None = None
    pv_low: float | None = None
    pv_high: float | None = None
    deviation: float | None = None
    time_s: float | None = None
    rest_s: float | None = None
    cycles: int = 4
    bias: float = 0.0
    hysteresis: float | None = None
    kc0: float | None = None


def on_demand(path: Path, kind: Kind, options: OnDemand, question: Question) -> int:
    """Conduct an experiment, evaluate it, and write the settings if they are confirmed; the exit status.

    Raises
    ------
    ConfigError, UserError, DeviceError
        The configuration, an option, the folder or the bus cannot be used; nothing was touched.
    """
    config = overridden(load_config(path), RunOptions(options.interface, options.channel))
    in_process = config.bus.interface == "virtual"
    if in_process:
        make_plant(config)
    speed = real_time_speed(options.speed, simulated=in_process)
    plan = plan_for(config, kind, options)
    folder = options.out or Path(f"{config.output.directory}-experiment")
    screen = RunScreen(screen_console(stderr=options.as_json), config.loop.pv_unit, quiet=options.as_json)
    fresh = fresh_folder(folder)
    try:
        with stoppable(), Ledger(folder / LEDGER) as ledger, screen:
            log = folder / BUS_LOG
            place: AbstractContextManager[Bench] = simulated(config, log) if in_process else live(config, speed, log)
            with place as bench:
                return OnDemandExperiment(
                    config, plan, question, folder, ledger, screen, bench, yes=options.yes, as_json=options.as_json
                ).run()
    except (DeviceError, UserError):
        if not (folder / RECORD).exists():  # nothing happened: leave no folder behind
            give_back(fresh)
        raise


def plan_for(config: Config, kind: Kind, options: OnDemand) -> Plan:
    """The plan that options and configuration make.

    Raises
    ------
    UserError
        An option is out of its range.
    """
    loop, dt = config.loop, config.loop.sample_time_s
    span = loop.pv_max - loop.pv_min
    room = span if kind == Kind.SETPOINT else loop.co_max_pct - loop.co_min_pct
    with user_input(f"retuner experiment {kind}"):
        return Plan(
            kind=kind,
            amplitude=_or(options.amplitude, DEFAULT_SHARE * room),
            pv_low=_or(options.pv_low, loop.pv_min),
            pv_high=_or(options.pv_high, loop.pv_max),
            deviation=_or(options.deviation, DEFAULT_DEVIATION * span),
            co_low=loop.co_min_pct,
            co_high=loop.co_max_pct,
            time_s=_or(options.time_s, DEFAULT_SAMPLES * dt),
            rest_time_s=_or(options.rest_s, REST_WAIT_SAMPLES * dt),
            cycles=options.cycles,
            bias=options.bias,
            hysteresis=options.hysteresis,
            kc0=options.kc0,
        )


def _or(given: float | None, default: float) -> float:
    """What was given, else the default."""
    return default if given is None else given
