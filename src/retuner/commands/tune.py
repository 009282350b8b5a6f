"""retuner tune: settings for a known process by a tuning rule."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.explanation import Explanation
from retuner.errors import UserError, user_input
from retuner.tuning import tune as tune_model
from retuner.tuning import tuning_lines


@dataclass(frozen=True, slots=True)
class Process:
    """The process as the options describe it; times in seconds, None where an option was not given."""

    type: str | None
    k: float | None
    tau1_s: float
    tau2_s: float
    theta_s: float

    def model(self) -> ProcessModel | None:
        """The model, or None when the options describe none.

        Raises
        ------
        UserError
            Only a part of a model is given, or a value is out of its range.
        """
        if self.type is None:
            if self.k is not None or any((self.tau1_s, self.tau2_s, self.theta_s)):
                raise UserError(f"--type is missing: give one of {', '.join(ProcessType)}")
            return None
        if self.type not in set(ProcessType):
            raise UserError(f"--type {self.type}: give one of {', '.join(ProcessType)}")
        if self.k is None:
            raise UserError("--k is missing: the steady-state gain, or the slope gain per second of integrating types")
        with user_input("retuner tune"):
            return ProcessModel(ProcessType(self.type), self.k, self.tau1_s, self.tau2_s, self.theta_s)


@dataclass(frozen=True, slots=True)
class TuneOptions:
    """The command's options beside the process; times in seconds."""

    rule: str
    kind: str | None
    form: str | None
    wishes: dict[str, float | None]
    explain: bool = False
    plot: Path | None = None
    as_json: bool = False


def tune(process: Process, options: TuneOptions) -> int:
    """Work out and show settings; the exit status: 0, or 1 when the loop that follows would not be stable.

    Raises
    ------
    UserError
        An option is out of its range, or the rule has no answer for this process.
    """
    model = process.model()
    with user_input("retuner tune"):
        result = tune_model(model, options.rule, kind=options.kind, form=options.form, **options.wishes)
    if options.plot is not None:
        from retuner.commands.tune_pictures import draw_one  # noqa: PLC0415  matplotlib only when a picture is wanted

        draw_one(model, result, options.plot)
    why = result.explanation if options.explain else None
    if options.as_json:
        shown = {"model": model.to_dict() if model else None, **result.to_dict()}
        shown |= {"explanation": why.to_dict()} if why else {}
        sys.stdout.write(json.dumps(shown, indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("\n".join([*tuning_lines(result), *(explained(why) if why else [])]) + "\n")
    return 0 if result.margins is None or result.margins.stable else 1


def explained(why: Explanation) -> list[str]:
    """Formula, numbers put in, source and range in lines."""
    numbers = "  ".join(f"{name} = {value:.6g}" for name, value in why.numbers.items())
    lines = [f"  formula   {line}" for line in why.formula]
    lines += [f"  put in    {numbers}"] if numbers else []
    lines += [f"            {line}" for line in why.with_numbers if line not in why.formula]
    return [*lines, f"  source    {why.source}", f"  range     {why.valid}"]
