"""`retuner.diagnose`: the cause behind a loop's records, its odds and its cure, as a frozen result."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from retuner.adaptive import display_hook
from retuner.adaptive.cause_odds.odds import diagnose_records
from retuner.adaptive.choice.foreseen import ASKED, Foreseen, foreseen, weighed_models
from retuner.adaptive.controller_settings.changed_settings import differ, under_one_setting
from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.explanations.settings_by_odds import likely_processes, models
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.indexes.days import days_of
from retuner.adaptive.loop.margins import Margins
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import Window
from retuner.api import Record, followed_settings, window_of, within
from retuner.drivers.historian.time_stamps import Numbers, Times
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.plain_values import plain_values
from retuner.tuning import TuneResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class RecordDiagnosis(display_hook.Shown):
    """The cause of a loop's behaviour, the process where it could be told, and the settings that would cure it.

    Attributes
    ----------
    fits : explanations of pv by name ("linear", "external", "stuck"), on the samples that were fitted.
    aim : where the settings are a first step only (identification/first_step.py), those that they lead to.
    record : what it was told from, for the picture; None where it was not kept.
    active : the settings in force, as given or as read off the record; None where neither is known.
    co_limits : lowest and highest co as given.
    likely : the processes that the settings rest on where these come from the odds of many (adaptive/explanations/),
        the likeliest first; else empty, and `model` is the process.
    room : times all actions in force that stay robust on next to every process, and on half of the odds; None where
        settings do not come from odds.
    on : which of several records it is told of, from 0.
    foreseen : what the settings, or where none are recommended the best of each likely process, would have made of that
        record; None where the tuning is not in question.
    earlier : gains of each record that ran under others than those in force, else None.
    """

    diagnosis: Diagnosis
    estimate: ModelEstimate | None
    settings: TuneResult | None
    fits: Mapping[str, npt.NDArray[np.float64]]
    aim: TuneResult | None = None
    record: Window | None = field(default=None, compare=False)
    active: PidGains | None = None
    co_limits: tuple[float | None, float | None] = (None, None)
    likely: tuple[ProcessModel, ...] = ()
    room: tuple[float, float] | None = None
    on: int = 0
    foreseen: Foreseen | None = None
    earlier: tuple[PidGains | None, ...] = ()

    def __repr__(self) -> str:
        told = self.diagnosis
        return f"RecordDiagnosis({told.cause}, confidence {told.confidence:.0%}: {told.reason})"

    @property
    def cause(self) -> Cause:
        """What is behind the loop's behaviour."""
        return self.diagnosis.cause

    @property
    def model(self) -> ProcessModel | None:
        """The process, None where the record does not say enough."""
        if self.likely:
            return self.likely[0]
        return self.estimate.log.model() if self.estimate is not None and self.estimate.identifiable else None

    @property
    def recommended(self) -> PidGains | None:
        """The settings that would cure it; None where tuning is not the cause."""
        return self.settings.gains if self.settings is not None and self.diagnosis.retune else None

    @property
    def margins(self) -> Margins | None:
        """What the recommended settings leave on the best model."""
        return self.settings.margins if self.settings is not None and self.diagnosis.retune else None

    def plot(self) -> "Figure":
        """The picture that a notebook shows: the record, what explains it, and before and after.

        Raises
        ------
        ValueError
            The record was not kept.
        """
        figure: Figure = display_hook.figure(self)
        return figure

    def to_dict(self) -> dict[str, object]:
        """Keys cause, confidence, retune, evidence, reason, gains, form, margins, aim, rival, foreseen."""
        found = self.settings.to_dict() if self.settings and self.diagnosis.retune else {}
        rival = self.estimate.rival if self.estimate is not None else None
        return {
            **self.diagnosis.to_dict(),
            "aim": self.aim.to_dict()["gains"] if self.aim else None,
            "rival": rival.to_dict() if rival is not None else None,
            **{name: found.get(name) for name in ("gains", "form", "margins")},
            **plain_values(self, "foreseen"),
        }


def diagnose(
    t: Times | Record | Sequence[Record],
    sp: Numbers | None = None,
    pv: Numbers | None = None,
    co: Numbers | None = None,
    *,
    gains: PidGains | None = None,
    co_min: float | None = None,
    co_max: float | None = None,
) -> RecordDiagnosis:
    """Name the cause of a loop's behaviour.

    Parameters
    ----------
    t, sp, pv, co : the record in automatic, see identify; or t is a list of records of one loop, all with the same
        controller, from oldest to newest: each adds to the odds, and so does each day of a record of
        several. gains : the controller in force; where it is not given it is read off the record if the record shows
        it. co_min, co_max : limits of the controller output, co units.

    Returns
    -------
    RecordDiagnosis
        The cause with its confidence and evidence; settings where tuning is the cause.

    Raises
    ------
    ValueError
        Shapes differ, a value is not finite, or time does not increase; a record cannot be read, or there is none.

    Examples
    --------
    A loop whose setpoint and output stand still while nothing moves it:

    >>> import numpy as np
    >>> t = np.arange(0.0, 400.0, 1.0)
    >>> pv = 50.0 + 0.1 * np.random.default_rng(1).standard_normal(400)
    >>> diagnose(t, np.full(400, 50.0), pv, np.full(400, 30.0)).cause
    <Cause.UNKNOWN: 'unknown'>
    """
    if isinstance(t, list | tuple) and sp is None:
        if not t:
            raise ValueError("there is no record in the list")
        windows = [window_of(cast("Record", one), None, None, None) for one in t]
    else:
        windows = [window_of(cast("Times | Record", t), sp, pv, co)]
    windows = parts_of(windows, gains, co_min, co_max)
    found = diagnose_windows(windows, gains=gains, co_min=co_min, co_max=co_max)
    return replace(found, record=windows[found.on])


def parts_of(
    windows: Sequence[Window], gains: PidGains | None, co_min: float | None = None, co_max: float | None = None
) -> list[Window]:
    """The records that are diagnosed: each day of one by itself, and what ran under each of several settings.

    gains : in force, where they were given; then nobody asks when they came.
    """
    days = [day for window in windows for day in days_of(window)]
    return days if gains else [part for day in days for part in under_one_setting(day, co_min, co_max)]


def diagnose_windows(
    windows: Sequence[Window],
    *,
    gains: PidGains | None = None,
    co_min: float | None = None,
    co_max: float | None = None,
    cause_only: bool = False,
) -> RecordDiagnosis:
    """The diagnosis of several records of one loop with one controller: each adds to the odds.

    Where no gains are given, those of the newest record that shows any are in force. cause_only : what settings would
    gain is not worked out.
    """
    windows = [within(window, co_min, co_max) for window in windows]
    direction = rough = None
    earlier: tuple[PidGains | None, ...] = (None,) * len(windows)
    if gains is None:
        # gains that the newest record shows, else rough ones, and the direction of the controller
        each = [settings_in_force(window, co_min, co_max) for window in windows]
        newest = next((one for one in reversed(each) if one.gains is not None), None)
        if newest is not None:
            gains, earlier = newest.gains, tuple(one.gains if differ(one, newest) else None for one in each)
        else:
            rough = next((one.rough for one in reversed(each) if one.rough is not None), None)
        signs = [one.direction for one in each if one.direction is not None]
        direction = (1 if sum(signs) > 0 else -1) if signs else None
    told = diagnose_records(windows, gains, co_min, co_max, direction=direction, rough=rough, earlier=earlier)
    found, worth = told.found, told.settings
    fits = {name: c.fit.at.explained for name, c in found.fits.items()}
    now, aim = (followed_settings(found.estimate, tuning) for tuning in (found.tuning, found.aim))
    if worth is not None:
        now = TuneResult.on(worth.tuning, worth.models[0])
    settings = now.gains if now is not None and found.diagnosis.retune else None
    # what the settings save of the record's error, or the best for each process, over its odds
    saved: Foreseen | None = None
    if not cause_only and found.diagnosis.cause in {Cause.OK, *TUNING_CAUSES}:
        if told.tuning is not None and found.tuning is None:
            likely = likely_processes(told.tuning, ASKED)
            processes = list(zip(models(told.tuning, likely), likely.weights.tolist(), strict=True))
        else:
            processes = weighed_models(found.estimate)
        saved = foreseen([windows[told.record]], processes, settings, gains, (co_min, co_max))
    return RecordDiagnosis(
        with_gain(found.diagnosis, saved),
        found.estimate,
        now,
        fits,
        aim,
        active=gains,
        co_limits=(co_min, co_max),
        likely=worth.models if worth is not None else (),
        room=(worth.sure, worth.likely) if worth is not None else None,
        on=told.record,
        foreseen=saved,
        earlier=earlier,
    )


def with_gain(told: Diagnosis, saved: Foreseen | None) -> Diagnosis:
    """The verdict with what tuning could gain; a loop that is too tight is not calmed for its error."""
    little = saved is not None and not saved.due and told.cause is Cause.SLUGGISH
    if saved is None or told.cause not in {Cause.OK, Cause.SLUGGISH} or (saved.given and not little):
        return told
    which = "these settings would" if saved.given else "if the process were known, the best settings would"
    band = f" ({100.0 * saved.least:.0f} to {100.0 * saved.most:.0f} %)" if saved.most - saved.least > BAND else ""
    band = " only: nothing is due" if little else band
    reason = f"{told.reason}; {which} take away {100.0 * saved.saved:.0f} % of the error{band}"
    return replace(told, reason=reason, settled=told.settled and not little)


BAND = 0.01  # a narrower range of the share is not told
