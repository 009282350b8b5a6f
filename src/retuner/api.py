"""`retuner.identify`: the process behind a record of arrays or of a file, as a frozen result."""

import math
from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from retuner.adaptive import display_hook
from retuner.adaptive.choice.foreseen import Foreseen, foreseen, weighed_models
from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.controller_settings.summed_law import rough_law
from retuner.adaptive.diagnosis.one_tone import one_tone
from retuner.adaptive.diagnosis.sticking_valve import pv_stands_verdict
from retuner.adaptive.fit.record import setpoint_changes
from retuner.adaptive.identification.by_region import FEWEST_SAMPLES, RegionRecord, by_region, identify_region
from retuner.adaptive.identification.dead_time_bound import bounded
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.identification.first_step import first_step
from retuner.adaptive.identification.identify import FROM_MOTION, FitSettings, identify_manual, identify_window
from retuner.adaptive.identification.in_parts import identify_parts
from retuner.adaptive.identification.robust_simc import RobustSettings, RobustTuning, robust_simc
from retuner.adaptive.indexes.days import days_of
from retuner.adaptive.loop.margins import Margins, margins
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import FloatArray, Window, in_units
from retuner.adaptive.valve.stand_still import StandStillSettings, stand_still
from retuner.drivers.historian.data_frames import is_frame
from retuner.drivers.historian.loop_record import LoopRecord, read_loop_record
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.historian.time_stamps import Numbers, Times, seconds
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.plain_values import plain_values
from retuner.tuning import TuneResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Frame(Protocol):
    """A frame of pandas, polars or arrow: it has columns by name."""

    @property
    def columns(self) -> Any:  # noqa: ANN401  each library has its own
        """The columns, or their names."""


Record = LoopRecord | Frame | str | PathLike[str]
"""A whole recorded loop: as `read` gives it, as a frame, or the path of an export."""


@dataclass(frozen=True, slots=True)
class Identification(display_hook.Shown):
    """What a record says of its process, and the settings that follow (None when it does not say enough).

    Attributes
    ----------
    aim : where one event asks for far more gain than is in force, the settings are a first step only
        (identification/first_step.py), and these are what they lead to.
    step_reason : why; empty where there is no aim.
    record : what it was found from, for the picture; None where it was not kept.
    foreseen : share of the record's error that the settings would take away; None in manual and without settings.
    """

    estimate: ModelEstimate
    settings: TuneResult | None
    margins_in_force: Margins | None
    aim: TuneResult | None = None
    step_reason: str = ""
    record: Window | None = field(default=None, compare=False)
    foreseen: Foreseen | None = None

    def __repr__(self) -> str:
        if not self.estimate.identifiable:
            return f"Identification(not identifiable: {self.estimate.reason})"
        m = self.estimate.log.model()
        lags = "".join(f" {name} {time:.4g} s" for name, time in m.times_s.items())
        return f"Identification({m.type}: k {m.k:.4g}{lags} theta {m.theta_s:.4g} s; settings {self.settings!r})"

    @property
    def identifiable(self) -> bool:
        """Whether the record says enough of the process."""
        return self.estimate.identifiable

    @property
    def model(self) -> ProcessModel | None:
        """The process, None where the record does not say enough."""
        return self.estimate.log.model() if self.estimate.identifiable else None

    @property
    def recommended(self) -> PidGains | None:
        """The settings that follow."""
        return self.settings.gains if self.settings is not None else None

    @property
    def margins(self) -> Margins | None:
        """What these settings leave on the best model."""
        return self.settings.margins if self.settings is not None else None

    def plot(self) -> "Figure":
        """The picture that a notebook shows; ValueError where the record was not kept."""
        figure: Figure = display_hook.figure(self)
        return figure

    def to_dict(self) -> dict[str, object]:
        """Keys identifiable, model, std, gains, margins, aim, step_reason, margins_in_force, reason, loads, ..."""
        found = self.settings.to_dict() if self.settings else {}
        return {
            **self.estimate.to_dict(),
            **{name: found.get(name) for name in ("gains", "form", "margins")},
            "aim": self.aim.to_dict()["gains"] if self.aim else None,
            **plain_values(self, "step_reason margins_in_force foreseen"),
        }


def identify(
    t: Times | Record,
    sp: Numbers | None = None,
    pv: Numbers | None = None,
    co: Numbers | None = None,
    *,
    open_loop: bool = False,
    gains: PidGains | None = None,
    co_min: float | None = None,
    co_max: float | None = None,
) -> Identification:
    """Find the process behind a record.

    Parameters
    ----------
    t : time in seconds, or moments (datetime64, a DatetimeIndex), increasing; or a whole record, which has all four: of
        `retuner.read`, a frame of pandas, polars or arrow, or the path of an export.
    sp, pv : setpoint and process value, pv units. co : controller output, held between samples, co units. All of shape
        (n,), n >= 3.
    open_loop : the record is an experiment in manual. gains : the controller in force, for the sign
        of the process and its margins now. co_min, co_max : limits of the final element, co units; a recorded co
        beyond them is taken to have stood at the limit.

    Returns
    -------
    Identification
        Model, standard deviations and settings; `identifiable` is False where the record does not say enough.

    Raises
    ------
    ValueError
        Shapes differ, a value is not finite, time does not increase, or pv or co never moves; a record cannot be read
        (RecordingError, which is one).

    Examples
    --------
    A step of the output from 50 to 60 % in manual; pv follows with gain 2, lag 30 s and dead time 5 s:

    >>> import numpy as np
    >>> t = np.arange(0.0, 300.0, 1.0)
    >>> co = np.where(t < 20.0, 50.0, 60.0)
    >>> pv = 100.0 + 20.0 * -np.expm1(-np.maximum(t - 25.0, 0.0) / 30.0)
    >>> found = identify(t, pv, pv, co, open_loop=True)
    >>> found.identifiable
    True
    >>> found.model
    ProcessModel(type=<ProcessType.FOPDT: 'fopdt'>, ...)
    """
    window = window_of(t, sp, pv, co)
    found = identify_record(window, open_loop=open_loop, gains=gains, co_min=co_min, co_max=co_max)
    return replace(found, record=window)


def read(*sources: object, form: RecordForm | None = None, **known: Any) -> LoopRecord:
    """Read a recorded loop as it was exported; `assumed` of the result says what was made of its form.

    Parameters
    ----------
    sources : a path to text or Parquet, a folder, a frame of pandas, polars or arrow; or several that belong together.
    form : what is known of the record's form; or the fields of a RecordForm by name, as in tag="FIC101".

    Returns
    -------
    LoopRecord
        Time, setpoint, pv and output, and what was assumed; `identify` and `diagnose` take it.

    Raises
    ------
    RecordingError (a ValueError)
        It cannot be read, or is ambiguous; the message names what would answer it.
    TypeError
        No such field of a form.

    Examples
    --------
    >>> import pandas as pd
    >>> frame = pd.DataFrame({"PV": [20.0, 20.5, 21.0], "SP": [30.0, 30.0, 30.0], "OP": [50.0, 48.0, 47.0]})
    >>> read(frame, dt_s=10.0).recording.pv
    array([20. , 20.5, 21. ])
    """
    return read_loop_record(sources, replace(form or RecordForm(), **known))


def window_of(
    t: Times | Record, sp: Numbers | None = None, pv: Numbers | None = None, co: Numbers | None = None
) -> Window:
    """A record for a fit, out of arrays or as it was read.

    Raises ValueError: a signal is missing, shapes differ, a value is not finite or has no square, time does not rise.
    """
    if isinstance(t, LoopRecord | str | PathLike) or is_frame(t):
        if not (sp is None and pv is None and co is None):
            raise ValueError("a record brings its own sp, pv and co; give a record or arrays")
        return (t if isinstance(t, LoopRecord) else read(t)).recording.window()
    if sp is None or pv is None or co is None:
        raise ValueError("give t, sp, pv and co, or a record of retuner.read")
    # signals as they are measured: numpy would drop an imaginary part, and keep what stands under a mask
    signals = list[FloatArray]()
    for name, values in (("sp", sp), ("pv", pv), ("co", co)):
        given = np.asanyarray(values)
        if np.iscomplexobj(given):
            raise ValueError(f"{name} is complex; give real numbers, as they were measured")
        reals = given.astype(np.float64)
        filled = getattr(reals, "filled", None)  # of a masked array; np.ma is loaded by who has one
        signals.append(np.asarray(reals if filled is None else filled(np.nan)))
    return in_units(Window(seconds(cast("Times", t)), signals[0], signals[1], signals[2]))


def identify_record(
    window: Window,
    *,
    open_loop: bool = False,
    gains: PidGains | None = None,
    co_min: float | None = None,
    co_max: float | None = None,
) -> Identification:
    """The process behind a record that is a Window already; see identify."""
    window = within(window, co_min, co_max)
    if open_loop:
        return _followed(window, identify_manual(window, gains.direction if gains else None), gains, open_loop)
    days = days_of(window)
    sign = _sign_of(max(days, key=_length), gains, co_min, co_max)
    told = (
        identify_region(RegionRecord(-math.inf, math.inf, tuple(days)), sign, FitSettings()) if len(days) > 1 else None
    )
    if told is not None:
        return _followed(max(days, key=_length), told, gains, open_loop)
    found = _followed(window, identify_window(window, sign), gains, open_loop)
    joint = None if found.identifiable else identify_parts(window, sign)
    return found if joint is None else _followed(window, joint, gains, open_loop, by_parts=True)


@dataclass(frozen=True, slots=True)
class RegionIdentification:
    """What a record says of the process between two boundaries of a signal.

    low, high : the boundaries, infinite at the ends. samples : of the record there, in stretches long enough to be
    fitted.
    found : None where none of them moves.
    """

    low: float
    high: float
    samples: int
    found: Identification | None

    def to_dict(self) -> dict[str, object]:
        """Keys low, high (null at the ends), samples, and those of the identification; reason where there is none."""
        told = {"identifiable": False, "reason": NO_STRETCH} if self.found is None else self.found.to_dict()
        return plain_values(self, "low high samples") | told


NO_STRETCH = f"no stretch of {FEWEST_SAMPLES} samples and more in which pv and co move"  # why a region has no model


def identify_by_region(
    window: Window,
    by: Numbers,
    bounds: Sequence[float],
    *,
    open_loop: bool = False,
    gains: PidGains | None = None,
    co_min: float | None = None,
    co_max: float | None = None,
) -> tuple[RegionIdentification, ...]:
    """A process for each region that a record passes through, the lowest first (identification/by_region.py).

    window : the record. by : the signal with the boundaries, shape (n,): pv for a level whose gain rises with the
    level. bounds : the boundaries, increasing. The others : see identify.

    Raises ValueError: the boundaries are none, or see identify.
    """
    window, found = within(window, co_min, co_max), []
    sign = None if open_loop and gains is None else _sign_of(window, gains, co_min, co_max)
    for region in by_region(window, np.asarray(by, dtype=np.float64), bounds):
        estimate = identify_region(region, sign, FROM_MOTION if open_loop else FitSettings())
        told = None if estimate is None else _followed(max(region.stretches, key=_length), estimate, gains, open_loop)
        found.append(RegionIdentification(region.low, region.high, sum(map(_length, region.stretches)), told))
    return tuple(found)


def _sign_of(window: Window, gains: PidGains | None, co_min: float | None, co_max: float | None) -> int | None:
    """Sign of the process gain: of a loop that works that of its controller, given or read off; None for not known."""
    return gains.direction if gains else settings_in_force(window, co_min, co_max).direction


def _length(window: Window) -> int:
    return len(window.t_s)


def _followed(
    window: Window, estimate: ModelEstimate, gains: PidGains | None, open_loop: bool, *, by_parts: bool = False
) -> Identification:
    if open_loop or setpoint_changes(window):  # a load whose time is not known bounds no dead time
        estimate = bounded(window, estimate, FitSettings())
    if estimate.identifiable and not open_loop:
        estimate = _unless_pv_stands(window, gains, estimate)
        period_s = one_tone(window)
        if period_s is not None:
            reason = (
                f"all that moves pv is an oscillation of {period_s:.3g} s while the setpoint stands: "
                "it shows the controller, not the process; make a setpoint step"
            )
            estimate = replace(estimate, identifiable=False, reason=reason)
    if not estimate.identifiable:
        return Identification(estimate, None, None)
    found = robust_simc(estimate, window.sample_time_s, RobustSettings(), gains)
    settings = TuneResult.on(found.tuning, estimate.log.model())
    if (estimate.coloured or by_parts) and not open_loop:
        from retuner.adaptive.cause_odds.doubt_of_settings import doubt_of_settings  # noqa: PLC0415  few records ask

        if doubt := doubt_of_settings(window, settings.gains, by_parts=by_parts):
            return Identification(replace(estimate, identifiable=False, reason=doubt), None, None)
    told = Identification(estimate, settings, None)
    if gains is not None:
        # no more gain at once than the record's events carry
        model, dt = estimate.log.model(), window.sample_time_s
        told = replace(told, margins_in_force=margins(model.linear(), gains))
        events = len(setpoint_changes(window)) + len(estimate.load_times_s)
        step = first_step(robust_simc(estimate, dt, RobustSettings(), gains), gains, events, model, dt)
        if step is not None:
            now = followed_settings(estimate, step.now)
            told = replace(told, settings=now, aim=told.settings, step_reason=step.sentence)
    if open_loop:
        return told
    return replace(told, foreseen=foreseen([window], weighed_models(estimate)[:FEW], told.recommended, gains))


FEW = 5  # processes of one that is known, on which its settings are tried


def _unless_pv_stands(window: Window, gains: PidGains | None, estimate: ModelEstimate) -> ModelEstimate:
    """The estimate, unless pv stands still while co travels: that shows no process, and diagnosis says so as well."""
    settings = StandStillSettings()
    law = gains or rough_law(window)
    found = stand_still(window, law, settings) if law is not None else None
    if found is None or not (found.stands or found.dead):
        return estimate
    if found.lead_of(estimate.residual_std**2, len(estimate.load_times_s)) > settings.likelier:
        return estimate
    return replace(estimate, identifiable=False, reason=pv_stands_verdict(found, {}).reason)


def within(window: Window, co_min: float | None, co_max: float | None) -> Window:
    """The record with co inside the limits of the final element.

    Raises ValueError: a limit is not finite or they leave no room.
    """
    low, high = -np.inf if co_min is None else co_min, np.inf if co_max is None else co_max
    if not low < high:
        raise ValueError(f"co_min {low:g} and co_max {high:g} leave no room between them")
    return replace(window, co=np.clip(window.co, low, high))


def followed_settings(estimate: ModelEstimate | None, found: RobustTuning | None) -> TuneResult | None:
    """Settings with their margins on the best model, where there are any."""
    if found is None or estimate is None:
        return None
    return TuneResult.on(found.tuning, estimate.log.model())
