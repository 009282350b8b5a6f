"""`retuner.design_schedule`: a gain schedule from ordinary records of a loop, with what it rests on."""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import cast

import numpy as np

from retuner.adaptive import display_hook
from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.indexes.days import at_gaps
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.schedule_choice.boundaries_of_one_variable import Layout
from retuner.adaptive.schedule_choice.boundaries_of_two_variables import COUNT, Cells
from retuner.adaptive.schedule_choice.schedule_from_records import (
    Design,
    NextExperiment,
    design,
    first_sets,
    next_experiment,
)
from retuner.adaptive.schedule_choice.scheduling_variables import OWN, SchedulingVariable, follows_loop, silent
from retuner.adaptive.schedule_design.places import DesignLimits, Place, model_of
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.api import Record, window_of, within
from retuner.drivers.historian.time_stamps import Numbers
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.plain_values import plain_value, plain_values
from retuner.schedule.regions import CAN, Axis, Regions
from retuner.schedule.table import GainTable, Lookup

AUTO = "auto"
SCHEMA = 1  # Version of the JSON document
NOTHING: Mapping[str, Sequence[Numbers]] = MappingProxyType({})
DIGITS = 5  # Significant digits of gains, boundaries and times in the table: a person reads them


@dataclass(frozen=True, slots=True)
class RecordedGains:
    """The gains in force at each sample of the records, one record after the other, parallel: kp, ki, kd.

    Raises ValueError: they are not of one length, or a value is not finite.
    """

    kp: FloatArray
    ki: FloatArray
    kd: FloatArray

    def __post_init__(self) -> None:
        if not len(self.kp) == len(self.ki) == len(self.kd):
            raise ValueError(f"active gains: {len(self.kp)} of kp, {len(self.ki)} of ki, {len(self.kd)} of kd")
        if not np.all(np.isfinite(np.concatenate([self.kp, self.ki, self.kd]))):
            raise ValueError("active gains: give finite numbers")

    def near(self, x: float, visited: FloatArray) -> PidGains | None:
        """The gains in force when the variable was nearest to x. visited : its value at each of these samples."""
        away = np.abs(visited - x)
        rows = np.argsort(away)[:NEAREST]
        if not len(rows) or away[rows[0]] > NEAR_SHARE * float(np.ptp(visited)):
            return None
        return PidGains(*(float(np.median(values[rows])) for values in (self.kp, self.ki, self.kd)))


NEAREST = 25  # samples whose median counts
NEAR_SHARE = 0.05  # share of the range within which a sample is near


@dataclass(frozen=True, slots=True)
class ScheduleDesign(display_hook.Shown):
    """A gain schedule and what it rests on.

    design : curves, places, sets and the evidence of each candidate variable. table : the gain table, None where
    nothing is known well enough. in_force : the gains while the records were made, where they are known. limits : that
    were demanded. records : that it was found from. co_range : limits of the output, where they are known.
    visited : the variable at each of their samples. aim : the table that this one leads to once the next record
    confirms it, where the records do not carry it at once (schedule_from_records.py). print shows it as the
    command does, a notebook with its picture.
    """

    design: Design
    table: GainTable | None
    in_force: GainTable | PidGains | RecordedGains | None = None
    limits: DesignLimits = field(default_factory=DesignLimits)
    records: tuple[Window, ...] = ()
    co_range: tuple[float | None, float | None] = (None, None)
    visited: FloatArray = field(default_factory=lambda: np.zeros(0))
    aim: GainTable | None = None

    def __repr__(self) -> str:
        sets = 0 if self.table is None else len(self.table.gains)
        return f"ScheduleDesign(by {self.variable}: {self.reason}; {sets} sets, {len(self.places)} places)"

    @property
    def variable(self) -> str:
        """The variable that the schedule follows."""
        return self.design.variable

    @property
    def places(self) -> tuple[Place, ...]:
        """Places along the variable, with process, band and settings of each."""
        return self.design.places

    @property
    def reason(self) -> str:
        """How many sets, or why there are none."""
        return self.design.reason

    @property
    def second(self) -> str:
        """Another variable that the schedule follows as well, "" for none."""
        return self.design.second

    @property
    def slices(self) -> tuple[float | None, ...]:
        """Values of the second variable at which a picture over the first is drawn; (None,) where there is none."""
        if not self.second:
            return (None,)
        return tuple(self.places[i].x2 for i in (0, COUNT // 2, COUNT - 1))

    def model_at(self, x: float, x2: float | None = None) -> ProcessModel:
        """The process at x, and x2 of a second variable; outside the records' range as at its end."""
        curves = self.design.curves
        return model_of(curves.ln(np.array([x]), None if x2 is None else np.array([x2]))[0], curves.form.sign)

    def gains_at(self, x: float, x2: float | None = None) -> PidGains:
        """The gains that the table has in force at x, and x2 of a second variable, when it rests there.

        Raises ValueError: there is no table, or it follows two variables and x2 is not given.
        """
        layout = self.layout
        if isinstance(layout, Layout):
            return layout.gains_at(x)
        if x2 is None:
            raise ValueError(f"the schedule follows {self.variable} and {self.second}: give a value of each")
        return layout.gains_at(x, x2)

    def before_at(self, x: float, x2: float | None = None) -> PidGains | None:
        """The gains that were in force at x (and x2), where they are known."""
        if isinstance(self.in_force, RecordedGains):
            return self.in_force.near(x, self.visited)
        if not isinstance(self.in_force, GainTable):
            return self.in_force
        regions, values = self.in_force.regions, (x, x2) if self.second and x2 is not None else (x,)
        if len(regions.axes) != len(values):
            return None
        cell = tuple(bisect_right(axis.bounds, value) for axis, value in zip(regions.axes, values, strict=True))
        return self.in_force.at(regions.region_at(cell), *values)

    @property
    def next_experiment(self) -> NextExperiment:
        """The experiment that would teach most."""
        return next_experiment(self.design.curves, self.places, self.co_range)

    @property
    def at_limits(self) -> float:
        """Share of the samples at which co stood at a limit that is known, or at one that the records show."""
        return at_limits(self.records, self.co_range)

    @property
    def layout(self) -> Layout | Cells:
        """The sets along the variable; errors as gains_at."""
        if self.design.layout is None:
            raise ValueError(f"no schedule follows from these records: {self.reason}")
        return self.design.layout

    def to_dict(self) -> dict[str, object]:
        """Keys schema, variable, second, reason, candidates, lookup, regions, aim, hysteresis, min_stay_s,
        crossings, at_limits, next_experiment, places.
        """
        places = list[dict[str, object]]()
        for place in self.places:
            told: dict[str, object] = {
                **plain_values(place, "x" if place.x2 is None else "x x2"),
                **plain_values(place, "known model"),
                "ln_std": dict(zip(("slope", "theta", "tau", "tau2"), place.ln_std, strict=False)),
                **plain_values(place, "own"),
            }
            if self.table is not None:
                gains = self.gains_at(place.x, place.x2)
                told |= {"gains": plain_value(gains), **plain_values(place.judged(gains), "ms ms_worst j")}
            places.append(told)
        return {
            "schema": SCHEMA,
            "variable": self.variable,
            "second": self.second or None,
            "reason": self.reason,
            "candidates": [
                plain_values(e, "variable ln_evidence changes ln_likelihood=log_likelihood")
                | {"chosen": e.variable == " and ".join(filter(None, (self.variable, self.second)))}
                for e in self.design.candidates
            ],
            "lookup": None if self.table is None else str(self.table.lookup),
            **plain_values(self.design, "hysteresis min_stay_s"),
            "regions": [] if self.table is None else _regions_dict(self.table),
            "aim": None if self.aim is None else _regions_dict(self.aim),
            **plain_values(self.design, "crossings"),
            **plain_values(self, "at_limits next_experiment"),
            "places": places,
        }


def _regions_dict(table: GainTable) -> list[dict[str, object]]:
    told, axes = list[dict[str, object]](), len(table.regions.axes)
    for i, (name, gains) in enumerate(zip(table.regions.names, table.gains, strict=True)):
        where: dict[str, object] = {}
        for axis, digit in enumerate(("", "2")[:axes]):
            low, high = table.regions.span(i, axis)
            where |= {f"low{digit}": low, f"high{digit}": high, f"centre{digit}": table.regions.centre(i, axis)}
        told.append({"name": name, **where, **plain_value(gains)})
    return told


def design_schedule(
    records: Window | Record | Sequence[Window | Record],
    by: str | Sequence[str] = AUTO,
    *,
    values: Mapping[str, Sequence[Numbers]] = NOTHING,
    low: float | None = None,
    high: float | None = None,
    co_min: float | None = None,
    co_max: float | None = None,
    ms_limit: float = 1.8,
    j_limit: float = 1.25,
    lookup: str = AUTO,
    name: str = "loop",
    unit: str = "",
    gains: GainTable | PidGains | RecordedGains | None = None,
    progress: Callable[[str, float], None] = silent,
) -> ScheduleDesign:
    """Find what of a process changes along a variable, and the fewest sets of gains that serve it everywhere.

    Parameters
    ----------
    records : of one loop, in automatic or manual, one or several: frames, paths, or what `retuner.read` gives.
    by : the variable, "sp", "pv", "co" or a key of values; several of them, or "auto" for all: the evidence
        chooses one, or two that both matter. values : further variables, one array for each record at its samples.
    low, high : ends of the first variable; left out, what the records visit. co_min, co_max : limits of the final
        element.
    ms_limit : largest Ms at any place on any model that the records allow. j_limit : largest J over that of a place's
        own settings. lookup : "hard", "interpolated" or "auto". name, unit : of the loop and of the variable.
    gains : in force while the records were made: no set goes farther from them than the records carry at once; left
        out, they are read off the records where these show them. progress : told each stage and the share done.

    Returns
    -------
    ScheduleDesign
        The gain table, and what it rests on at every place; no table where none follows, with the reason.

    Raises
    ------
    ValueError
        A record or a value cannot be used, or nothing moves; the message says which.
    """
    whole = tuple(within(window, co_min, co_max) for window in windows_of(records))
    if lookup not in {AUTO, *Lookup}:
        raise ValueError(f"lookup = {lookup!r}: give {AUTO}, {' or '.join(Lookup)}")
    if low is not None and high is not None and not low < high:
        raise ValueError(f"low = {low:g} must be below high = {high:g}")
    rows = [at_gaps(window) for window in whole]
    windows = tuple(window.part(part) for window, parts in zip(whole, rows, strict=True) for part in parts)
    names = [*OWN, *values] if by == AUTO else [by] if isinstance(by, str) else list(dict.fromkeys(by))
    candidates = [_candidate(one, whole, rows, values) for one in names]
    limits = DesignLimits(ms_limit, j_limit)
    found = design(windows, candidates, limits, lookup, (low, high), progress)
    before = gains
    if before is None:
        read_off = (settings_in_force(window, co_min, co_max).gains for window in windows)
        before = next((one for one in read_off if one is not None and one.ki), None)
    named = {one.name: np.concatenate(one.values) for one in candidates}
    visited = named[found.variable]
    if isinstance(before, RecordedGains) and len(before.kp) != len(visited):
        raise ValueError(f"active gains at {len(before.kp)} samples, the records have {len(visited)}")
    made = ScheduleDesign(found, table_of(found, name, unit), before, limits, windows, (co_min, co_max), visited)
    first = first_sets(found, windows, [named[n] for n in (found.variable, found.second) if n], made.before_at)
    if first.aim is None:
        return made
    aim = table_of(replace(first, layout=first.aim), name, unit)
    return replace(made, design=first, table=table_of(first, name, unit), aim=aim)


def windows_of(records: Window | Record | Sequence[Window | Record]) -> tuple[Window, ...]:
    """Records, one or several, as windows. Raises ValueError: there is none, or one lacks a signal."""
    several = list(records) if isinstance(records, list | tuple) else [cast("Window | Record", records)]
    if not several:
        raise ValueError("no record; give at least one")
    return tuple(one if isinstance(one, Window) else window_of(one) for one in several)


def _candidate(
    name: str,
    windows: Sequence[Window],
    rows: Sequence[Sequence[slice]],
    values: Mapping[str, Sequence[Numbers]],
) -> SchedulingVariable:
    """A variable at the samples of every part of the records. rows : the parts of each."""
    if name in values:
        arrays = [np.asarray(v, dtype=np.float64) for v in values[name]]
        if len(arrays) != len(windows):
            raise ValueError(f"{name}: {len(arrays)} arrays for {len(windows)} records; give one for each")
    elif name in OWN:
        arrays = [np.asarray(getattr(window, name), dtype=np.float64) for window in windows]
    else:
        known = ", ".join([*OWN, *values])
        raise ValueError(f"by = {name!r}: no such variable; there is {known}")
    for array, window in zip(arrays, windows, strict=True):
        if array.shape != window.t_s.shape or not np.all(np.isfinite(array)):
            raise ValueError(f"{name}: give a finite value at each of the record's {len(window.t_s)} samples")
    follows = name not in OWN and follows_loop(windows, arrays)
    parted = tuple(array[part] for array, parts in zip(arrays, rows, strict=True) for part in parts)
    return SchedulingVariable(name, parted, follows=follows)


def table_of(found: Design, name: str, unit: str) -> GainTable | None:
    """The gain table of a design; None where it has no sets."""
    if found.layout is None:
        return None
    first = _axis(found.variable, unit, found.layout.edges, found.hysteresis, found.min_stay_s)
    n = len(found.layout.sets)
    few = {1: ("all",), 2: ("low", "high"), 3: ("low", "middle", "high")}
    second, names = None, few.get(n, tuple(f"part {i + 1}" for i in range(n)))
    if isinstance(found.layout, Cells):
        second = _axis(found.second, "", found.layout.edges2, found.second_hysteresis, found.min_stay_s)
        names = tuple(f"{i + 1}-{j + 1}" for i in range(len(first)) for j in range(len(second)))
    regions = Regions.along(names, first, second)
    sets = tuple(PidGains(*(_rounded(g) for g in (s.kp, s.ki, s.kd))) for s in found.layout.sets)
    return GainTable(name, regions, sets, found.layout.lookup)


def _axis(variable: str, unit: str, layout: Sequence[float], hysteresis: float, min_stay_s: float) -> Axis:
    edges = [_rounded(edge) for edge in layout]
    own = variable in OWN
    return Axis(
        variable if own else CAN,
        unit,
        edges[0],
        tuple(edges[1:-1]),
        edges[-1],
        _rounded(hysteresis, 2),
        _rounded(min_stay_s, 2),
        signal="" if own else variable,
    )


STANDS = 5  # samples in a row at the lowest or highest co of all, from which that is a limit


def at_limits(windows: Sequence[Window], co_range: tuple[float | None, float | None]) -> float:
    """See ScheduleDesign. windows : the records. co_range : limits of the output, where they are known."""
    if not windows:
        return 0.0
    ends = min(float(w.co.min()) for w in windows), max(float(w.co.max()) for w in windows)
    if not ends[0] < ends[1]:
        return 0.0
    low, high = (seen if known is None else known for known, seen in zip(co_range, ends, strict=True))
    margin = 1e-6 * (ends[1] - ends[0])
    stood = 0
    for window in windows:
        for there in (window.co <= low + margin, window.co >= high - margin):
            runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]))))[::2]
            stood += int(np.sum(runs[runs >= STANDS]))
    return stood / sum(len(w.t_s) for w in windows)


def _rounded(value: float, digits: int = DIGITS) -> float:
    return float(f"{value:.{digits}g}")


__all__ = ["AUTO", "OWN", "Record", "ScheduleDesign", "design_schedule", "table_of"]
