"""retuner init: the starter as it stands, a loop by the answers of a person, or the loop of a record.

A configuration by answers is for the controller that a person has. That of a record runs at once: its plant is the
process that was identified in the record, under a load of the same spectrum, with the record's setpoint.
"""

import json
import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.indexes.days import days_of
from retuner.api import identify_record
from retuner.commands.options import put_file
from retuner.commands.recorded.recorded_loop import SHARE
from retuner.commands.signatures import InitOptions
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.recorded.recording import RecordingError
from retuner.errors import UserError, user_input
from retuner.schedule.gains import Form, PidGains, from_form, in_form
from retuner.templates import profiles, starter

OVEN, NATIVE = "oven", "retuner"
RANGE_MARGIN = 0.25
"""Share of a record's range added on both sides for the transmitter's range, which the record does not tell."""
MOST_STEPS = 40
"""Setpoint changes of a record that a scenario takes over; more are a ramp, and then the first value stays."""
PERCENT = (-0.5, 100.5)
LARGE, MOST_NODES = 1e12, 127


def init(options: InitOptions) -> int:
    """Write a configuration; the exit status.

    Raises UserError, RecordingError: no file can go where it should, one is there, or the record or an answer cannot be
    used.
    """
    path = options.path
    if path.is_dir():
        raise UserError(f"{path}: is a folder; give the name of a file in it")
    if path.exists() and not options.force:
        raise UserError(f"{path}: exists; give another name, or --force to replace it")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: the folder {path.parent} does not exist; make it first")
    asking = not options.profile and (
        options.ask or (options.ask is None and sys.stdin.isatty() and sys.stderr.isatty())
    )
    if options.record is not None:
        with user_input("--kc, --tau-i, --tau-d"):
            kc = options.kc
            gains = None if kc is None else from_form(Form.SERIES, kc, options.tau_i, options.tau_d)
        texts = of_record(options.record, path, gains)
    else:
        texts = {path: asked(path) if asking else starter(options.profile)}
    for file, text in texts.items():
        put_file(file, text)
    sys.stdout.write(f"{path} written. Next: retuner check {path}, then retuner run {path}\n")
    return 0


def asked(file: Path) -> str:
    """A configuration by questions, each with a default that Enter takes."""
    known = (OVEN, NATIVE, *profiles())

    def read(text: str) -> str:
        if text not in known:
            raise ValueError(f"give one of {', '.join(known)}")
        return text

    controller = _ask(f"Controller: {', '.join(known)} (oven: a simulated one, to try)", OVEN, read)
    if controller == OVEN:
        return starter()
    interface = _ask("CAN interface, as python-can calls it", "socketcan", str)
    channel = _ask("CAN channel", "can0", str)
    node = _ask("Number of the controller on the bus", 1, _node)
    if controller != NATIVE:
        text = re.sub(r"(?m)^node = \d+", f"node = {node}", starter(controller))
        bus = f"interface = {json.dumps(interface)}\nchannel = {json.dumps(channel)}\n"
        return text.replace("[bus]\n", f"[bus]\n{bus}") if "[bus]\n" in text else f"{text}\n[bus]\n{bus}"
    name, unit = _ask("Name of the loop", file.stem, str), _ask("Unit of pv", "degC", str)
    low = _ask("Range of pv, low end", 0.0, _number(-LARGE))
    high = _ask("Range of pv, high end", low + 100.0, _number(math.nextafter(low, LARGE)))
    sample_s = _ask("Sampling interval of the controller, s", 1.0, _number(1e-4, 3600.0))
    any_gain = _number(-math.inf, math.inf, but=0.0)
    kc = _ask(f"Gain Kc now, % of output per {unit} (negative: direct acting)", 1.0, any_gain)
    tau_i = _ask("Integral time tau_I now, s (0: none)", 100.0, _number(0.0))
    gains = from_form(Form.SERIES, kc, tau_i or None, _ask("Derivative time tau_D now, s", 0.0, _number(0.0)))
    return _composed("by your answers", name, unit, (low, high), sample_s, gains, interface, channel, node)


Answer = TypeVar("Answer")


def _ask(text: str, default: Answer, read: Callable[[str], Answer]) -> Answer:
    """Ask until the answer can be used; read : an answer as a value, or ValueError with what to give."""
    while True:
        sys.stderr.write(f"{text} [{default}]: ")
        sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            raise UserError("the questions ended before the last answer; nothing was written")
        try:
            return read(line.strip()) if line.strip() else default
        except ValueError as error:
            sys.stderr.write(f"  {error}\n")


def _number(low: float, high: float = LARGE, *, but: float | None = None) -> Callable[[str], float]:
    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError("give a number")
        if value == but:
            raise ValueError(f"give a number other than {but:g}")
        if not low <= value <= high:
            raise ValueError(f"give a number from {low:g} to {high:g}")
        return value

    return read


def _node(text: str) -> int:
    if not text.isdecimal() or int(text) > MOST_NODES:
        raise ValueError(f"give a whole number from 0 to {MOST_NODES}")
    return int(text)


def of_record(record: Path, file: Path, given: PidGains | None) -> dict[Path, str]:
    """The configuration of a record's loop, and the model beside it where the record shows one, by path.

    record : of the loop in automatic. file : where the configuration goes. given : gains that were in force, None to
    read them off the record.

    Raises UserError, RecordingError: the record cannot be read, its co is not in percent, or it does not show the gains
    and none are given.
    """
    try:
        read = read_loop_record([record], in_automatic=True)
    except RecordingError as error:
        told, by_name, _ = str(error).partition("; name it as in --columns")
        raise UserError(f"{told}; rename it in the record, which the run reads as well") if by_name else error from None
    window = read.recording.window()
    low, high = float(window.co.min()), float(window.co.max())
    if low < PERCENT[0] or high > PERCENT[1] or high <= SHARE[1]:
        raise UserError(f"{record}: co runs from {low:g} to {high:g}; a configuration has percent, so convert it first")
    gains = given or settings_in_force(max(days_of(window), key=lambda day: len(day.t_s))).gains
    if gains is None:
        raise UserError(f"{record}: the record does not show the active gains; give --kc, --tau-i and --tau-d")
    low, high = float(window.pv.min()), float(window.pv.max())
    size = max(high - low, 1e-6 * max(abs(low), abs(high), 1.0))
    unit = 10.0 ** math.floor(math.log10(size))
    ends = (
        math.floor((low - RANGE_MARGIN * size) / unit) * unit,
        math.ceil((high + RANGE_MARGIN * size) / unit) * unit,
    )
    pv_range = float(f"{ends[0]:.9g}"), float(f"{ends[1]:.9g}")
    source = f"of {record.name}: range of pv with room, interval and gains as the record shows them"
    text = _composed(source, read.tag or record.stem, "units", pv_range, window.sample_time_s, gains)
    with user_input(str(record)):
        found = identify_record(window, gains=gains)
    if found.model is None:
        return {file: f"{text}\n# No plant to try it on: {found.estimate.reason}\n"}
    model = file.with_suffix(".model.json")
    # the sections of a virtual device with the record's process, and a scenario with its setpoint
    recording = read.recording
    sp = recording.pv if recording.sp is None else recording.sp
    at = [0, *(np.flatnonzero(np.diff(sp)) + 1).tolist()]
    at = at if len(at) <= MOST_STEPS else at[:1]
    t_s = recording.t_s - recording.t_s[0]
    steps = "".join(f"  {{ at_s = {t_s[i]:.9g}, sp = {sp[i]:.9g} }},\n" for i in at)
    return {
        model: json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n",
        file: text
        + f"""
[device]     # take it and [scenario] out for the real controller
kind = "virtual"

[device.plant]
kind = "identified"
file = {json.dumps(str(model))}
record = {json.dumps(str(record))}

[scenario]
duration_s = {t_s[-1]:.9g}
steps = [
{steps}]
""",
    }


def _composed(
    source: str,
    name: str,
    unit: str,
    pv_range: tuple[float, float],
    sample_time_s: float,
    gains: PidGains,
    interface: str = "virtual",
    channel: str = "retuner",
    node: int = 1,
) -> str:
    kc, tau_i, tau_d = (in_form(gains, Form.SERIES)[key] for key in ("kc", "tau_i", "tau_d"))
    return f"""# retuner configuration {source}.
# `retuner check FILE` says what is wrong with it; docs/configuration.md has every key with its default.
schema = 1

[loop]
name = {json.dumps(name)}
pv_unit = {json.dumps(unit)}
pv_min = {pv_range[0]!r}
pv_max = {pv_range[1]!r}
sample_time_s = {sample_time_s:.9g}

[schedule]   # one region; a run proposes boundaries where the process changes

[[schedule.region]]
name = "all"
kc = {kc:.6g}      # series form, percent of output per pv unit
tau_i_s = {'"none"' if tau_i is None else f"{tau_i:.6g}"}
tau_d_s = {tau_d or 0.0:.6g}

[adaptation]
mode = "advise"   # off: only watch; advise: propose; trial: write one change, keep it when approved; auto: write

[bus]
interface = {json.dumps(interface)}
channel = {json.dumps(channel)}
node = {node}
"""
