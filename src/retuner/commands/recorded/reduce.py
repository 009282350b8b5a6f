"""retuner reduce: a process of any order to a first- or second-order model."""

import json
import math
import sys
from typing import Annotated

import typer

from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.process.reduction import Leads, Reduction
from retuner.adaptive.process.reduction import reduce as reduce_process
from retuner.commands.options import Json
from retuner.errors import UserError, user_input

GAIN_UNIT = {ProcessType.INTEGRATING: "/s", ProcessType.INTEGRATING_LAG: "/s", ProcessType.DOUBLE_INTEGRATING: "/s2"}


app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner reduce --num-t 15 --den-t 20,1,0.1,0.1 --k 2 --order 2")
def reduce(
    num_t: Annotated[
        list[str] | None, typer.Option("--num-t", help="Numerator time constants, s; negative: inverse response.")
    ] = None,
    den_t: Annotated[list[str] | None, typer.Option("--den-t", help="Lags, s, separated by commas.")] = None,
    integrators: Annotated[int, typer.Option(help="Pure integrators.")] = 0,
    delay: Annotated[float, typer.Option(help="Dead time, s.")] = 0.0,
    order: Annotated[int, typer.Option(help="Order of the model: 1 for PI, 2 for PID.")] = 1,
    k: Annotated[float, typer.Option(help="Steady-state gain; slope gain per second with an integrator.")] = 1.0,
    leads: Annotated[
        str, typer.Option(help="auto; rules: T1 to T3 for all positive numerator time constants; subtract: none.")
    ] = "auto",
    as_json: Json = False,
) -> int:
    """Reduce a process model to first or second order by the half rule."""
    if leads not in set(Leads):
        raise UserError(f"--leads {leads}: give one of {', '.join(Leads)}")
    zeros, lags = time_constants("--num-t", num_t or []), time_constants("--den-t", den_t or [])
    if min(lags, default=1.0) <= 0:
        raise UserError(
            f"--den-t {min(lags):g}: a lag must be positive; a negative one is an unstable pole, and an "
            "integrator is counted by --integrators"
        )
    if integrators < 0:
        raise UserError(f"--integrators {integrators}: give 0, 1 or 2")
    with user_input("retuner reduce"):
        process = LinearProcess(k, lags, zeros, delay, integrators)
        found = reduce_process(process, order, Leads(leads))
    if as_json:
        sys.stdout.write(json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("\n".join(described(found)) + "\n")
    return 0


def time_constants(option: str, texts: list[str]) -> tuple[float, ...]:
    """Seconds from an option that may be repeated, each time with one or several numbers.

    Raises
    ------
    UserError
        A part is not a finite number.
    """
    found = []
    for part in " ".join(texts).replace(",", " ").split():
        try:
            value = float(part)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise UserError(f"{option} {part}: give seconds, separated by commas, as in {option} 5,3,0.5")
        found.append(value)
    return tuple(found)


def described(found: Reduction) -> list[str]:
    """Steps and model in lines."""
    return [*found.steps, *model_lines(found.model)]


def model_lines(model: ProcessModel) -> list[str]:
    """A model in lines; times that its structure does not have are left out."""
    lines = [f"{model.type}", f"  k      {model.k:10.6g} {GAIN_UNIT.get(model.type, '')}".rstrip()]
    times = (("tau1", model.tau1_s), ("tau2", model.tau2_s))
    lines += [f"  {name}   {value:10.6g} s" for name, value in times if value]
    return [*lines, f"  theta  {model.theta_s:10.6g} s"]
