"""Gain table to the [schedule] of a configuration, in the forms that people write there."""

import json

from retuner.schedule.gains import to_ideal
from retuner.schedule.regions import CAN
from retuner.schedule.table import GainTable, Lookup


def schedule_section(table: GainTable, loop: str = "") -> str:
    """The [schedule] of a configuration (loop.toml) that runs this table.

    loop : its name where it is one of several; its section is then [loop.schedule], below its [[loop]].
    """
    axes = table.regions.axes
    simple = table.lookup is Lookup.HARD and len(axes) == 1 and axes[0].variable != CAN
    lines = ["[schedule]"]
    if table.lookup is Lookup.INTERPOLATED:
        lines.append('lookup = "interpolated"')
    for axis in axes:  # a simple one in [schedule] itself
        lines += [] if simple else ["", "[[schedule.axis]]"]
        lines.append(f'variable = "{axis.variable}"')
        lines += [] if simple else [f"range = [{axis.low!r}, {axis.high!r}]"]
        if axis.variable == CAN:
            unit, signal = json.dumps(axis.unit or "-"), json.dumps(axis.signal)  # quoted as TOML has it
            lines += [f"unit = {unit}", 'message = "FILL_IN"', f"signal = {signal}"]
        lines += [f"bounds = [{', '.join(map(repr, axis.bounds))}]"] if axis.bounds else []
        for key in ("hysteresis", "min_stay_s", "filter_s"):
            lines += [f"{key} = {getattr(axis, key)!r}"] if getattr(axis, key) else []
    for i, (region, gains) in enumerate(zip(table.regions.names, table.gains, strict=True)):
        cell = [] if len(axes) == 1 else [f"cell = [{', '.join(str(place + 1) for place in table.regions.cell(i))}]"]
        ideal = to_ideal(gains)
        told = '"none"' if ideal.tau_i_s is None else repr(_digits(ideal.tau_i_s))
        lines += ["", "[[schedule.region]]", f'name = "{region}"', f"kc = {_digits(ideal.kc)!r}", f"tau_i_s = {told}"]
        lines += [f"tau_d_s = {_digits(ideal.tau_d_s)!r}"] if ideal.tau_d_s else []
        lines += ['form = "ideal"', *cell]
    text = "\n".join(lines) + "\n"
    if not loop:
        return text
    below = text.replace("\n[[schedule.", "\n[[loop.schedule.").replace("[schedule]", "[loop.schedule]", 1)
    return f"# Of the loop {json.dumps(loop)}: to stand below its [[loop]], before the next one.\n{below}"


def _digits(value: float) -> float:
    """A number to eight digits."""
    return float(f"{value:.8g}")
