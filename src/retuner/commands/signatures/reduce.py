"""The options of `retuner reduce`."""

from dataclasses import dataclass
from typing import Annotated

import typer

from retuner.commands.options import Json, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReduceOptions:
    """Reduce a process model to first or second order by the half rule."""

    num_t: Annotated[
        list[str] | None, typer.Option("--num-t", help="Numerator time constants, s; negative: inverse response.")
    ] = None
    den_t: Annotated[list[str] | None, typer.Option("--den-t", help="Lags, s, separated by commas.")] = None
    integrators: Annotated[int, typer.Option(help="Pure integrators.")] = 0
    delay: Annotated[float, typer.Option(help="Dead time, s.")] = 0.0
    order: Annotated[int, typer.Option(help="Order of the model: 1 for PI, 2 for PID.")] = 1
    k: Annotated[float, typer.Option(help="Steady-state gain; slope gain per second with an integrator.")] = 1.0
    leads: Annotated[
        str, typer.Option(help="auto; rules: T1 to T3 for all positive numerator time constants; subtract: none.")
    ] = "auto"
    as_json: Json = False


command(
    app,
    ReduceOptions,
    "recorded.reduce.reduce",
    "Example: retuner reduce --num-t 15 --den-t 20,1,0.1,0.1 --k 2 --order 2",
)
