"""retuner tune: settings for a known process by a tuning rule."""

import json
import sys
from dataclasses import dataclass

from retuner.adaptive.process import ProcessModel, ProcessType
from retuner.api import TuneResult
from retuner.api import tune as tune_model
from retuner.errors import UserError, user_input


@dataclass(frozen=True, slots=True)
class TuneOptions:
    """The command's options; times in seconds."""

    process: str
    k: float
    tau1_s: float
    tau2_s: float
    theta_s: float
    rule: str
    tau_c_s: float | None
    kind: str
    form: str | None


def tune(options: TuneOptions, *, as_json: bool) -> int:
    """Work out and show settings; the exit status: 0, or 1 when the loop that follows would not be stable.

    Raises
    ------
    UserError
        An option is out of its range, or the rule has no answer for this process.
    """
    if options.process not in set(ProcessType):
        raise UserError(f"--type {options.process}: give one of {', '.join(ProcessType)}")
    with user_input("retuner tune"):
        model = ProcessModel(ProcessType(options.process), options.k, options.tau1_s, options.tau2_s, options.theta_s)
        result = tune_model(model, options.rule, tau_c=options.tau_c_s, kind=options.kind, form=options.form)
    if as_json:
        sys.stdout.write(json.dumps({"model": model.to_dict(), **result.to_dict()}, indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("\n".join(described(result)) + "\n")
    return 0 if result.margins.stable else 1


def number(value: object, unit: str = "") -> str:
    """A number as people read it; none and infinite have words."""
    if value is None:
        return "none"
    assert isinstance(value, float)
    return f"{value:.4g}{unit}"


def described(result: TuneResult) -> list[str]:
    """Settings and margins in lines."""
    shown = result.to_dict()
    gains, parallel, m = shown["gains"], shown["parallel"], result.margins
    assert isinstance(gains, dict)
    assert isinstance(parallel, dict)
    times = f"tau_I {number(gains['tau_i'], ' s')}  tau_D {number(gains['tau_d'], ' s')}"
    ki, kd = number(parallel["ki"], "/s"), number(parallel["kd"], " s")
    lines = [
        f"{result.tuning.rule}, tau_c {number(result.tuning.tau_c_s, ' s')}",
        f"  {result.form:<8}  Kc {number(gains['kc'])}  {times}",
        f"  parallel  kp {number(parallel['kp'])}  ki {ki}  kd {kd}",
    ]
    if not m.stable:
        return [*lines, "  the closed loop would be UNSTABLE"]
    return [*lines, f"  margins   Ms {m.ms:.3f}  Mt {m.mt:.3f}  GM {m.gm:.3g}  PM {m.pm_deg:.1f} deg  "
                    f"delay margin {m.delay_margin_s:.4g} s"]  # fmt: skip
