"""What can be foreseen of a configuration that is well formed: gains of the wrong sign, limits that stand in the way.

The sign is compared where the plant is known, which is a simulated one. Limits are compared with the gains in the file,
and with the first setpoint step whose proportional action alone is more than the output has room for.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from retuner.config.model import Config
from retuner.products import product
from retuner.schedule.controller_units import Acting
from retuner.schedule.gains import PidGains
from retuner.session.assembly import guard_settings


class Warned(NamedTuple):
    """One thing foreseen. wrong : it cannot work, not only in the way."""

    text: str
    wrong: bool = False


def foreseen(config: Config) -> list[Warned]:
    """Everything that can be foreseen, the worst first."""
    return [*_wrong_signs(config), *_limits_passed(config), *_first_step(config)]


def _wrong_signs(config: Config) -> Iterator[Warned]:
    """Regions whose gains drive the plant away."""
    if config.device is None or config.device.plant is None:
        return
    plant, regions = product("plants").known_plant(config), config.regions()
    if plant is None:
        return
    for i, gains in enumerate(config.gains()):
        first = regions.axes[0]
        at = regions.centre(i) if first.variable in {"sp", "pv"} else (config.loop.pv_min + config.loop.pv_max) / 2
        k = plant.linearise(at).k
        if math.copysign(1, k) == gains.direction:
            continue
        falls = "falls" if k < 0 else "rises"
        needed = Acting.DIRECT if k < 0 else Acting.REVERSE
        yield Warned(
            f"region {regions.names[i]}: the plant's pv {falls} when the output rises, which needs a {needed}-acting "
            f"controller; these gains are {Acting.of(gains)} acting: change their sign, or [loop] action",
            wrong=True,
        )


def _limits_passed(config: Config) -> Iterator[Warned]:
    """Gains in the file that stand beyond the limits of changes already."""
    limits = guard_settings(config)
    for name, gains in zip(config.regions().names, config.gains(), strict=True):
        tau_i_s = gains.kp / gains.ki if gains.ki else None
        tau_d_s = gains.kd / gains.kp if gains.kp else 0.0
        for what, value, least, most in (
            ("kc", abs(gains.kp), limits.kc_min, limits.kc_max),
            ("tau_i", tau_i_s, limits.tau_i_min_s, limits.tau_i_max_s),
            ("tau_d", tau_d_s, 0.0, limits.tau_d_max_s),
        ):
            if value is None or least <= value <= most:
                continue
            side, limit = ("below", least) if value < least else ("above", most)
            yield Warned(
                f"region {name}: {what} = {value:g} (parallel form) is {side} the limit of [adaptation], {limit:g}: "
                "changes may only lead towards it"
            )


def _first_step(config: Config) -> Iterator[Warned]:
    """The first setpoint step that takes the output to its limit at once."""
    if config.scenario is None:
        return
    room = config.loop.co_max_pct - config.loop.co_min_pct
    wanted = [(step.at_s, step.sp) for step in config.scenario.steps if step.sp is not None]
    for (_, before), (at_s, after) in pairwise(wanted):
        kick = abs(config.loop.b * _gains_at(config, after).kp * (after - before))
        if kick > room:
            yield Warned(
                f"scenario: the step of sp from {before:g} to {after:g} at {at_s:g} s moves the output by {kick:.0f} % "
                f"at once; its range is {room:g} %, so it will hit its limit, which hides the response"
            )
            return


def _gains_at(config: Config, sp: float) -> PidGains:
    """The gains at a setpoint, or of the first region where the gains follow something else."""
    axis, gains = config.regions().axes[0], config.gains()
    if len(config.regions().axes) > 1 or axis.variable not in {"sp", "pv"}:
        return gains[0]
    return gains[sum(bound <= sp for bound in axis.bounds)]
