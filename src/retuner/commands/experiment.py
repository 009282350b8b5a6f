"""retuner experiment step|setpoint|relay|ultimate|valve: on demand against a controller, with limits, restored
afterwards; or the evaluation of a recorded one (--from FILE).
"""

import typer

from retuner.commands.options import signed_by
from retuner.commands.work.experiment_options import (
    RelayOptions,
    SetpointOptions,
    StepOptions,
    UltimateOptions,
    ValveOptions,
)

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="Make a step, setpoint or relay test, or evaluate a recorded one.",
    epilog="Example: retuner experiment relay examples/oven.toml --amplitude 5",
)


@app.command(
    "step",
    epilog="Examples: retuner experiment step examples/oven.toml --amplitude 5; "
    "retuner experiment step --from heater.csv --columns pv=temperature",
)
@signed_by(StepOptions)
def step(options: StepOptions) -> int:
    """A step of co; the exit status."""
    from retuner.commands.work import experiment as work

    return work.step(options)


@app.command(
    "setpoint",
    epilog="Examples: retuner experiment setpoint examples/oven.toml --amplitude 5 --kc0 1.5; "
    "retuner experiment setpoint --from loop.csv --kc0 1.5 --rule setpoint-overshoot",
)
@signed_by(SetpointOptions)
def setpoint(options: SetpointOptions) -> int:
    """A step of the setpoint; the exit status."""
    from retuner.commands.work import experiment as work

    return work.setpoint(options)


@app.command(
    "relay",
    epilog="Examples: retuner experiment relay examples/oven.toml --amplitude 10 --bias 0.3; "
    "retuner experiment relay --from relay.csv --rule zn-ultimate --kind pid",
)
@signed_by(RelayOptions)
def relay(options: RelayOptions) -> int:
    """Relay feedback; the exit status."""
    from retuner.commands.work import experiment as work

    return work.relay(options)


@app.command("ultimate", epilog="Example: retuner experiment ultimate --from swing.csv --kc 3.2")
@signed_by(UltimateOptions)
def ultimate(options: UltimateOptions) -> int:
    """A recorded swing; the exit status."""
    from retuner.commands.work import experiment as work

    return work.ultimate(options)


@app.command(
    "valve",
    epilog="Examples: retuner experiment valve examples/oven.toml --step 0.5 --hold 120; "
    "retuner experiment valve --from valve.csv",
)
@signed_by(ValveOptions)
def valve(options: ValveOptions) -> int:
    """A valve test on a controller or by hand; the exit status."""
    from retuner.commands.work.valve_test import valve as work

    return work(options)
