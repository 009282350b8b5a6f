"""retuner check: what is wrong with a configuration, or what it says."""

import json
import sys
from typing import TYPE_CHECKING

import typer

from retuner.commands.options import ConfigFile, Json
from retuner.errors import ConfigError

if TYPE_CHECKING:  # slow to load, and `--help` needs none of it
    from collections.abc import Sequence

    from retuner.config.model import Config
    from retuner.schedule.regions import Axis

app = typer.Typer(add_completion=False)

UNUSABLE = 2  # exit status of a configuration that cannot be used: bad input


@app.command(epilog="Example: retuner check oven.toml")
def check(path: ConfigFile, as_json: Json = False) -> int:
    """Check a configuration: each error with file, line, key and limit; without errors, a summary."""
    from retuner.commands.run import foreseen
    from retuner.config.loading import UnusableError, parse_session, plants_here, read_text, with_signals

    try:
        text = read_text(path)
        session = with_signals(parse_session(text), text, bus=True)
        plants = plants_here(session, text)
    except UnusableError as unusable:
        if not as_json:
            raise ConfigError(*(finding.text(str(path)) for finding in unusable.findings)) from None
        problems = [{"line": f.line, "key": f.key, "message": f.message} for f in unusable.findings]
        _print_json({"ok": False, "file": str(path), "problems": problems})
        return UNUSABLE
    warned = [one for config in session.loops for one in foreseen(config)]
    wrong = any(one.wrong for one in warned)
    if as_json:
        told = {"problems": [], "warnings": [one.text for one in warned]}
        _print_json({"ok": not wrong, "file": str(path), **told, **session.summary()})
    else:
        lines = [
            line
            for config, model in zip(session.loops, plants, strict=True)
            for line in described(config, model, several=session.several)
        ]
        output = session.loops[0].output
        lines += [f"output      {output.directory}, trend as {output.trend}"]  # what a run leaves behind
        lines += [f"warning     {one.text}" for one in warned]
        sys.stdout.write(f"{path}: {'WRONG' if wrong else 'ok'}\n" + "".join(f"  {line}\n" for line in lines))
    return 1 if wrong else 0


def described(config: "Config", model: "Sequence[str]", *, several: bool) -> list[str]:
    """What the configuration of a loop says, in lines for a person; model : what its plant's model says of itself.
    several : it is one of several.
    """
    loop, bus = config.loop, config.bus
    where = config.regions()
    width = max(len(region.name) for region in config.schedule.regions)
    gains = [config.units.text(one, digits=6, acting=True) for one in config.gains()]
    lines = [
        f"loop        {loop.name}: pv {loop.pv_min:g} to {loop.pv_max:g} {loop.pv_unit}, "
        f"output {loop.co_min_pct:g} to {loop.co_max_pct:g} %, every {loop.sample_time_s:g} s",
        f"schedule    by {' and '.join(map(_axis_text, config.regions().axes))}, lookup {config.schedule.lookup}",
        *[f"  {region.name:<{width}}  {where.text(i)}: {gains[i]}" for i, region in enumerate(config.schedule.regions)],
        f"adaptation  {config.adaptation.mode}, rule {config.adaptation.rule}, "
        f"Ms at most {config.adaptation.ms_nominal:g} ({config.adaptation.ms_worst:g} on the worst model)",
        f"bus         {bus.interface}, channel {bus.channel}, node {config.node}",
    ]
    if config.device is not None:
        plant = config.device.plant
        behind = f"plant {plant.kind}, seed {config.device.seed}" if plant is not None else "a real one"
        lines.append(f"device      {config.device.kind}, {behind}")
        notes, foreign = list(model), config.foreign_device
        if foreign is not None:  # what a controller that is not ours cannot do, and how often it can be asked
            from retuner.config.described import advice_only, make_access

            access = make_access(config, foreign)
            reason, steps = advice_only(config), config.scenario.steps if config.scenario else []
            notes += [f"watched only: {reason}"] if reason else []
            if not access.takes_setpoint and sum(one.sp is not None for one in steps) > 1:
                notes.append("!! device.setpoint is missing: a step of sp in [scenario] ends the run")
            polled = getattr(access, "polled", lambda _: "")(config.loop.sample_time_s)
            notes += [polled] if polled else []
        lines += [f"            {line}" for line in notes]
    if config.scenario is not None:
        lines.append(f"scenario    {config.scenario.duration_s:g} s, {len(config.scenario.steps)} steps")
    return [*lines, ""] if several else lines


def _axis_text(axis: "Axis") -> str:
    parts = [
        f"{axis.signal} on the bus" if axis.signal else axis.variable,
        f"filter {axis.filter_s:g} s" * bool(axis.filter_s),
        f"hysteresis {axis.hysteresis:g} {axis.unit}" * bool(axis.hysteresis),
        f"stay {axis.min_stay_s:g} s" * bool(axis.min_stay_s),
    ]
    told = [part for part in parts if part]
    return told[0] + (f" ({', '.join(told[1:])})" if told[1:] else "")


def _print_json(value: object) -> None:
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n")
