"""retuner identify: the process behind a recorded response."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from retuner.api import Identification, identify_record
from retuner.commands.tune import described as tuning_lines
from retuner.drivers.recording import read_recording, require_excitation, require_setpoint
from retuner.errors import UserError, user_input
from retuner.schedule.forms import from_form
from retuner.schedule.gains import PidGains


@dataclass(frozen=True, slots=True)
class IdentifyOptions:
    """The command's options; times in seconds."""

    open_loop: bool = False
    columns: str = ""
    kc: float | None = None
    tau_i_s: float | None = None
    tau_d_s: float = 0.0
    form: str = "series"


ROLES = ("t", "sp", "pv", "co")


def identify(path: Path, options: IdentifyOptions, *, as_json: bool) -> int:
    """Identify and show; the exit status: 0, or 1 when the record does not say enough.

    Raises
    ------
    UserError, RecordingError
        The file or an option cannot be used.
    """
    gains = controller(options)
    recording = read_recording(path, renamed(options.columns))
    require_excitation(recording)
    if not options.open_loop:
        require_setpoint(recording)
    found = identify_record(recording.window(), open_loop=options.open_loop, gains=gains)
    if as_json:
        sys.stdout.write(json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("\n".join(described(found)) + "\n")
    return 0 if found.estimate.identifiable else 1


def renamed(text: str) -> dict[str, str]:
    """--columns as role to column name.

    Raises
    ------
    UserError
        A part is not role=name, a role is not known, or is given twice.
    """
    found: dict[str, str] = {}
    for part in (p.strip() for p in text.split(",") if p.strip()):
        role, equals, name = part.partition("=")
        if not equals or role not in ROLES or not name or role in found:
            raise UserError(f"--columns {part}: give role=name, each role once; roles are {', '.join(ROLES)}")
        found[role] = name
    return found


def controller(options: IdentifyOptions) -> PidGains | None:
    """The gains in force, when they were given."""
    if options.kc is None:
        if options.tau_i_s is not None or options.tau_d_s:
            raise UserError("--tau-i and --tau-d need --kc: give the gain of the controller in force, too")
        return None
    with user_input("--kc, --tau-i, --tau-d"):
        return from_form(options.form, options.kc, options.tau_i_s, options.tau_d_s)


def described(found: Identification) -> list[str]:
    """Model, standard deviations and settings in lines."""
    estimate = found.estimate
    model, std = estimate.log.model(), estimate.log.std()
    lines = ["identified" if estimate.identifiable else "NOT identifiable: " + estimate.reason,
             f"  k      {model.k:10.4g} +- {std['k']:.2g}",
             f"  tau1   {model.tau1_s:10.4g} +- {std['tau1']:.2g} s",
             f"  theta  {model.theta_s:10.4g} +- {std['theta']:.2g} s"]  # fmt: skip
    if estimate.identifiable:
        lines.append(f"  {estimate.reason}; residual {estimate.residual_std:.3g}, noise {estimate.noise_std:.3g}")
    if estimate.load_times_s:
        lines.append("  load steps at " + ", ".join(f"{t:.4g} s" for t in estimate.load_times_s))
    if found.settings is not None:
        lines += ["settings that follow:", *tuning_lines(found.settings)]
    if found.margins_in_force is not None:
        m = found.margins_in_force
        lines.append(f"with the gains in force: Ms {m.ms:.3f}, GM {m.gm:.3g}, PM {m.pm_deg:.1f} deg" if m.stable else
                     "with the gains in force this loop is UNSTABLE")  # fmt: skip
    return lines
