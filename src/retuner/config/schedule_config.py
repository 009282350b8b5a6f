"""[schedule]: which gains are in force where, along one scheduling variable or two."""

from collections.abc import Iterator
from itertools import pairwise
from math import prod
from typing import Annotated, Any, Literal

from pydantic import Field

from retuner.config.section import Many, Problem, Section, setting
from retuner.schedule.controller_units import Acting, ControllerUnits
from retuner.schedule.dials import KEYS, Dial
from retuner.schedule.gains import SECONDS_PER_MINUTE, Form, PidGains
from retuner.schedule.regions import CAN, Axis, Regions
from retuner.schedule.vendor_units import Quantity

IntegralTime = Annotated[float, Field(gt=0, le=1e9)]
Dials = tuple[Dial, Dial, Dial]
GAIN_KEYS = ("kc", "gain", "pb_pct")
INTEGRAL_KEYS = ("tau_i_s", "tau_i_min", "repeats_per_min")
DERIVATIVE_KEYS = ("tau_d_s", "tau_d_min")
EVERY_KEY = (GAIN_KEYS, INTEGRAL_KEYS, DERIVATIVE_KEYS)  # Keys of a region that say the same in other units, by action
NO_INTEGRAL = "none"  # how a person writes "no integral action": leaving it out by mistake must not mean the same
STALE_AFTER_S = 10.0
Edge = Annotated[float, Field(ge=-1e9, le=1e9)]


def _number(meaning: str, unit: str, low: float = -1e9) -> Any:  # noqa: ANN401  as setting()
    """A number of the controller that another one may stand for."""
    return setting(meaning, f"{low}..1e9 {unit}", None, "the active gains")


class RegionConfig(Section):
    """[[schedule.region]]: the gains of one operating region, in the units in which they stand on the controller."""

    name: str = setting("Name of the region in reports", "1..32 characters")
    kc: float | None = _number(
        "Controller gain of the named form, or gain or pb_pct; negative where [loop] action is not given and the "
        "controller is direct-acting",
        "%/pv",
    )
    gain: float | None = _number("In place of kc: gain in percent of the span of the output per percent of pv's", "%/%")
    pb_pct: float | None = _number("In place of kc: proportional band in percent of the span of pv", "%")
    tau_i_s: IntegralTime | Literal["none"] | None = setting(
        'Integral time of the named form, or "none" for no integral action; or tau_i_min or repeats_per_min',
        "s",
        None,
        "the active gains",
    )
    tau_i_min: IntegralTime | Literal["none"] | None = setting(
        "In place of tau_i_s: the same in minutes", "min", None, "the active gains"
    )
    repeats_per_min: float | None = _number(
        "In place of tau_i_s: repeats per minute, 0 for no integral action", "1/min", low=0
    )
    tau_d_s: float = setting("Derivative time of the named form", "0..1e9 s", 0.0, "the active gains")
    tau_d_min: float | None = _number("In place of tau_d_s: the same in minutes", "min", low=0)
    form: Literal["series", "ideal", "parallel"] = setting(
        "Form of these numbers; parallel means the times are kp/ki and kd/kp",
        default="series",
        source="SIMC's native form",
    )

    cell: Many[Annotated[int, Field(ge=1, le=64)]] = setting(
        "With two axes the place on each, counted from 1; for all regions or for none; if none, the second axis "
        "counts fastest",
        "0..2 entries",
        (),
        "the order in the file",
    )

    mode: Literal["off", "advise", "trial", "auto"] | None = setting(
        "What may be done in this region; absent: [adaptation] mode. --mode lowers it and does not raise it",
        default=None,
        source="user",
    )
    locked: Many[Literal["kc", "tau_i", "tau_d"]] | None = setting(
        "Parameters that stay as they are in this region; absent: those of [adaptation] locked",
        default=None,
        source="user",
    )

    def problems(self) -> Iterator[Problem]:
        """Gains that a controller can have, each told once."""
        for keys, needed in ((GAIN_KEYS, True), (INTEGRAL_KEYS, True), (DERIVATIVE_KEYS, False)):
            given = [key for key in keys if key in self.model_fields_set]
            if len(given) > 1:
                yield Problem((given[1],), f"conflicts with {given[0]}; give one of them")
            if needed and not given:
                yield Problem((keys[0],), f"is missing; add {', '.join(keys[:-1])} or {keys[-1]}")
        key = self.dials[0].key
        if key in self.model_fields_set and self.dialled == 0:
            yield Problem((key,), "= 0 would control nothing; give the active gain")

    @property
    def dials(self) -> Dials:
        """The numbers that are given, each with its unit."""
        given = [next((key for key in keys if key in self.model_fields_set), keys[0]) for keys in EVERY_KEY]
        return KEYS[given[0]], KEYS[given[1]], KEYS[given[2]]

    @property
    def dialled(self) -> float:
        """The gain or the proportional band, as it is given; its sign is that of kc."""
        return float(getattr(self, self.dials[0].key) or 0.0)

    @property
    def integral_time_s(self) -> float | None:
        """Integral time in seconds, None for no integral action."""
        number, dial = getattr(self, self.dials[1].key), self.dials[1]
        if number is None or number in {NO_INTEGRAL, 0.0}:
            return None
        return SECONDS_PER_MINUTE / number if dial.quantity is Quantity.REPEATS else float(number) * dial.scale

    def units(self, pv_span: float, action: Acting | None) -> ControllerUnits:
        """The units of its numbers. pv_span : of pv. action : of the controller, None where the sign tells it."""
        return ControllerUnits(self.dials, Form(self.form), pv_span, action=action)

    def gains(self, pv_span: float, action: Acting | None = None) -> PidGains:
        """The gains in parallel form; arguments as `units`."""
        gain, integral, derivative = (getattr(self, dial.key) for dial in self.dials)
        acts = self.integral_time_s is not None
        return self.units(pv_span, action).gains(gain, float(integral) if acts else None, derivative or 0.0)


class AxisConfig(Section):
    """[[schedule.axis]]: one scheduling variable and the boundaries on it; one or two of these."""

    variable: Literal["sp", "pv", "co", "can"] = setting("What the gains follow; can: another signal on the bus")
    unit: str | None = setting("Unit of the variable; absent: that of sp, pv or co", "1..16 characters", None, "[loop]")
    range: Many[Edge] = setting(
        "Lower and upper end of the variable; empty: those of sp, pv or co", "0..2 entries in unit", (), "[loop]"
    )
    bounds: Many[float] = setting("Boundaries on the axis, increasing", "unit", ())
    hysteresis: float = setting(
        "How far beyond a boundary a place is kept", "0..1e9 unit", 0.0, "more than the noise that the filter leaves"
    )
    min_stay_s: float = setting("Shortest stay in a place", "0..1e6 s", 0.0)
    filter_s: float = setting(
        "Time constant of the first-order filter of the variable; 0: none",
        "0..1e6 s",
        0.0,
        "none for sp; some samples for what is noisy",
    )
    dbc: str = setting(
        "With can: DBC file that describes the signal, relative to where the command runs; empty: the virtual device's "
        "own plant.dbc",
        "0..1024 characters",
        "",
    )
    message: str = setting("With can: name of the message in the DBC", "0..128 characters", "", "the DBC")
    signal: str = setting("With can: name of the signal in it", "0..128 characters", "", "the DBC")
    stale_after_s: float = setting(
        "With can: age of the last value after which the variable is not known; the region then stays, and no model is "
        "updated",
        ">0..1e6 s",
        STALE_AFTER_S,
        "ten frames at one a second",
    )

    def problems(self) -> Iterator[Problem]:
        """Boundaries in order and within the range, and all that belongs to the variable."""
        for i, (low, high) in enumerate(pairwise(self.bounds), 1):
            if low >= high:
                yield Problem(("bounds", i), f"= {high:g} must be greater than the bound before it, {low:g}")
        if len(self.range) == 1 or (self.range and self.range[0] >= self.range[1]):
            shown = ", ".join(f"{edge:g}" for edge in self.range)
            yield Problem(("range",), f"= [{shown}] must be two numbers, the lower end before the upper")
        if self.variable == CAN:
            yield from (Problem((key,), f"is missing; {what}") for key, what in NEEDED if not getattr(self, key))
        else:
            # what only a signal on the bus has
            named = [key for key in ("dbc", "message", "signal") if getattr(self, key)]
            for key in named + ["stale_after_s"] * (self.stale_after_s != STALE_AFTER_S):
                yield Problem(
                    (key,), f'belongs to variable = "{CAN}"; {self.variable} comes with every sample: leave it out'
                )

    def limits(self, unit: str, low: float, high: float) -> tuple[str, float, float]:
        """Unit and ends; unit, low, high : those of the variable in the loop, where they are not given here."""
        ends = self.range if len(self.range) == 2 else (low, high)
        return self.unit or unit, ends[0], ends[1]


NEEDED = (
    ("unit", "give the signal's unit"),
    ("range", "give the signal's lower and upper end, as in range = [0.0, 100.0]"),
    ("message", "give the name of the message in the DBC"),
    ("signal", "give the name of the signal in the message"),
)
"""What an axis along a signal on the bus must say."""


class ScheduleConfig(Section):
    """[schedule]: regions along a scheduling variable; [[schedule.axis]] for two, or for a signal on the bus."""

    variable: Literal["sp", "pv", "co"] = setting("What the gains follow", default="sp", source="sp is quiet")
    bounds: Many[float] = setting("Boundaries between the regions, increasing; none for a single region", "pv or %", ())
    hysteresis: float = setting(
        "How far beyond a boundary a region is kept",
        "0..1e9 pv or %",
        0.0,
        "more than the noise of the variable; 0 suits sp",
    )
    min_stay_s: float = setting("Shortest stay in a region", "0..1e6 s", 0.0)
    filter_s: float = setting(
        "Time constant of the first-order filter of the variable; 0: none",
        "0..1e6 s",
        0.0,
        "none for sp; some samples for a noisy pv",
    )
    lookup: Literal["hard", "interpolated"] = setting(
        "hard: the gains of the region; interpolated: weighted between the regions' centres",
        default="hard",
        source="the simplest to judge",
    )
    proposal: str = setting(
        "Hash of the proposal from which `retuner approve --into` took this schedule; the ledger of a run tells it",
        "0..64 characters",
        "",
        "retuner",
    )
    axis: Many[AxisConfig] = setting("One or two [[schedule.axis]] in place of the keys above", "0..2 entries", ())
    region: Many[RegionConfig] = setting(
        "One [[schedule.region]] for each region, from the lowest to the highest", "1..64 entries", source="user"
    )

    @property
    def axes(self) -> tuple[AxisConfig, ...]:
        """The axes, one or two, however they were written."""
        if self.axis:
            return self.axis
        return (AxisConfig.model_construct(None, **{key: getattr(self, key) for key in SIMPLE}),)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of places along each axis."""
        return tuple(len(axis.bounds) + 1 for axis in self.axes)

    @property
    def regions(self) -> tuple[RegionConfig, ...]:
        """The regions in their order: row by row, from the lowest to the highest."""
        if not all(region.cell for region in self.region):
            return self.region
        return tuple(sorted(self.region, key=lambda region: region.cell))

    def problems(self) -> Iterator[Problem]:
        """Problems of regions: as many as the bounds make, in order, all acting one way."""
        fields = type(self).model_fields
        beside = [key for key in SIMPLE if self.axis and getattr(self, key) != fields[key].default]
        yield from (Problem((key,), "conflicts with [[schedule.axis]]; write it into its axis") for key in beside)
        counts = " x ".join(str(len(axis.bounds)) for axis in self.axes)
        made, first = prod(self.shape), self.region[0]
        if len(self.region) != made:
            wanted = f"but {counts} bounds make {made} regions; give {made} [[schedule.region]] or other bounds"
            yield Problem(("region",), f"{len(self.region)} given, {wanted}")
        for i, (low, high) in enumerate(pairwise(self.bounds), 1):
            if low >= high:
                yield Problem(("bounds", i), f"= {high:g} must be greater than the bound before it, {low:g}")
        seen: set[str] = set()
        for i, region in enumerate(self.region):
            if region.name in seen:
                yield Problem(("region", i, "name"), f"{region.name!r} is taken by another region; give each its own")
            seen.add(region.name)
            if region.dialled * first.dialled < 0:
                against = f"acts against the first region's {first.dialled:g}; all regions act one way"
                yield Problem(("region", i, region.dials[0].key), f"= {region.dialled:g} {against}")
        # the cells of regions along two axes, given for all or for none
        given = any(region.cell for region in self.region)
        taken: dict[tuple[int, ...], str] = {}
        for i, region in enumerate(self.region):
            cell, shown, told = region.cell, ", ".join(map(str, region.cell)), ""
            if given and not cell:
                told = "is missing; give each region its cell, or none of them"
            elif cell and len(self.shape) == 1:
                told = f"= [{shown}] has no meaning with one axis; order the regions from the lowest to the highest"
            elif cell and (len(cell) != len(self.shape) or any(n > m for n, m in zip(cell, self.shape, strict=True))):
                told = f"= [{shown}] must be two numbers from 1 to {', '.join(map(str, self.shape))}"
            elif cell and cell in taken:
                told = f"= [{shown}] is region {taken[cell]!r} already"
            if told:
                yield Problem(("region", i, "cell"), told)
            taken.setdefault(cell, region.name)

    def as_regions(self, limits: tuple[tuple[str, float, float], ...]) -> Regions:
        """The regions as the schedule room knows them. limits : unit, lower and upper end of each axis' variable."""
        axes = [
            Axis(a.variable, unit, low, a.bounds, high, a.hysteresis, a.min_stay_s, a.filter_s, a.signal)
            for a, (unit, low, high) in ((a, a.limits(*its)) for a, its in zip(self.axes, limits, strict=True))
        ]
        return Regions.along(tuple(region.name for region in self.regions), *axes)


SIMPLE = ("variable", "bounds", "hysteresis", "min_stay_s", "filter_s")
"""The keys of [schedule] that describe its only axis when there is no [[schedule.axis]]."""
