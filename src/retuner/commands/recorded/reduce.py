"""retuner reduce: a process of any order to a first- or second-order model."""

import math

from retuner.adaptive.process.model import LinearProcess, ProcessType
from retuner.adaptive.process.reduction import Leads, Reduction
from retuner.adaptive.process.reduction import reduce as reduce_process
from retuner.commands.options import tell
from retuner.commands.signatures import ReduceOptions
from retuner.errors import UserError, user_input

GAIN_UNIT = {ProcessType.INTEGRATING: "/s", ProcessType.INTEGRATING_LAG: "/s", ProcessType.DOUBLE_INTEGRATING: "/s2"}


def reduce(options: ReduceOptions) -> int:
    """Reduce and show; the exit status.

    Raises UserError: an option is out of its range.
    """
    if options.leads not in set(Leads):
        raise UserError(f"--leads {options.leads}: give one of {', '.join(Leads)}")
    zeros, lags = time_constants("--num-t", options.num_t or []), time_constants("--den-t", options.den_t or [])
    if min(lags, default=1.0) <= 0:
        raise UserError(
            f"--den-t {min(lags):g}: a lag must be positive; a negative one is an unstable pole, and an "
            "integrator is counted by --integrators"
        )
    if options.integrators < 0:
        raise UserError(f"--integrators {options.integrators}: give 0, 1 or 2")
    with user_input("retuner reduce"):
        process = LinearProcess(options.k, lags, zeros, options.delay, options.integrators)
        found = reduce_process(process, options.order, Leads(options.leads))
    tell(found.to_dict(), described(found), as_json=options.as_json)
    return 0


def time_constants(option: str, texts: list[str]) -> tuple[float, ...]:
    """Seconds from an option that may be repeated, each time with one or several numbers.

    Raises UserError: a part is not a finite number.
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
    # A model in lines; times that its structure does not have are left out
    lines = [f"{found.model.type}", f"  k      {found.model.k:10.6g} {GAIN_UNIT.get(found.model.type, '')}".rstrip()]
    times = (("tau1", found.model.tau1_s), ("tau2", found.model.tau2_s))
    lines += [f"  {name}   {value:10.6g} s" for name, value in times if value]
    return [*found.steps, *[*lines, f"  theta  {found.model.theta_s:10.6g} s"]]
