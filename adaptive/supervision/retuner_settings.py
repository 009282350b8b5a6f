"""Settings of a retuner, its parts' settings among them."""

import math

from retuner.adaptive.choice.choice_settings import ChoiceSettings
from retuner.adaptive.diagnosis.cause import CauseSettings
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.oscillation_online import SwingSettings
from retuner.adaptive.diagnosis.swing_checks import LimitSwingSettings
from retuner.adaptive.explanations.settings_by_book import BookSettings
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.request import NO_LOCKS, Locks
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.identification.robust_simc import RobustSettings
from retuner.adaptive.identification.structure_choice import ON_LINE
from retuner.adaptive.region_model.from_neighbours import BorrowingSettings
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.signals.growth import GrowthSettings
from retuner.adaptive.signals.sample import EVERYWHERE
from retuner.adaptive.supervision.admission import AdmissionSettings
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.adaptive.without_model.proposal_without_model import WithoutModelSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.vendor_units import VendorUnits


@dataclass(frozen=True, slots=True)
class RetunerSettings:
    """Settings of one loop's retuner.

    Attributes
    ----------
    sample_time_s : of the controller.
    pv_span : range of pv, for the smallest noise band.
    pv_range : what the transmitter can say, pv units: what lies far outside teaches nothing.
    mode, region_modes : what it may do; in single regions by index, None or missing for `mode`.
    locks : parameters that stay as they are.
    region_locks : in single regions by index, None or missing for `locks`.
    band : noise band in pv units; None estimates it from the data.
    band_sigmas : noise standard deviations in the estimated band; 2 to 6, default 4.
    band_min_share : smallest band as a share of pv_span; default 0.001.
    wait_s : longest wait for the next peak; None takes wait_tau_i times tau_I in force.
    wait_tau_i, quiet_tau_i : waiting and settling time in units of tau_I; defaults 10 and 0.7.
    shortest_wait, shortest_quiet : and at least this many samples; defaults 60 and 12.
    history : most samples of one response; default 4000.
    lead_share, lead_samples : how much of the time before a response belongs to its window: this share of its length
        plus this many samples; defaults 0.25 and 20.
    fit : identification; its gain_std_limit is wider than for advice off line (0.3), because the guard proves every
        change on what is left open, and later records narrow it.
    growth : when a swing grows as only an unstable loop's does.
    limit_swing : what an unstable loop between the output's limits is told by.
    swing : when something else than the tuning is asked for.
    diagnosis : how, with the limits of cause that hold on line: a change is on trial there, and manual is told.
    cause : from which excess a tuning is the cause; slack 1.15, because later records narrow what is known.
    robust : how settings follow from what is known; less is held back for what the model cannot see than off line
        (ms_third 1.85, hidden_share 0.1), because it is seen again and again.
    setpoint_weight, filter_s : b of the controller and the filter time of its derivative, for what a change promises.
    units : how the controller keeps gains; None for one that keeps them as they are.
    choice : what a change must be expected to bring, and how surely.
    book : what all samples together say of the process, under loads that wander.
    gap_samples : a pause in the samples longer than this ends a response; default 8: where one sample in five is lost,
        so long a pause comes once in 400,000.

    Raises
    ------
    ValueError
        filter_s is not finite, or less than 0.
    """

    sample_time_s: float
    pv_span: float
    mode: Mode = Mode.ADVISE
    region_modes: tuple[Mode | None, ...] = ()
    locks: Locks = NO_LOCKS
    region_locks: tuple[Locks | None, ...] = ()
    band: float | None = None
    band_sigmas: float = 4.0
    band_min_share: float = 0.001
    wait_s: float | None = None
    wait_tau_i: float = 10.0
    quiet_tau_i: float = 0.7
    shortest_wait: int = 60
    shortest_quiet: int = 12
    history: int = 4000
    lead_share: float = 0.25
    lead_samples: int = 20
    gap_samples: int = 8
    setpoint_weight: float = 1.0
    filter_s: float = 0.0
    fit: FitSettings = field(default_factory=lambda: FitSettings(ON_LINE, gain_std_limit=0.3))
    tracker: TrackerSettings = field(default_factory=TrackerSettings)
    borrowing: BorrowingSettings = field(default_factory=BorrowingSettings)
    without_model: WithoutModelSettings = field(default_factory=WithoutModelSettings)
    admission: AdmissionSettings = field(default_factory=AdmissionSettings)
    swing: SwingSettings = field(default_factory=SwingSettings)
    growth: GrowthSettings = field(default_factory=GrowthSettings)
    limit_swing: LimitSwingSettings = field(default_factory=LimitSwingSettings)
    diagnosis: DiagnosisSettings = field(default_factory=lambda: DiagnosisSettings(cause=CauseSettings()).on_line())
    cause: CauseSettings = field(default_factory=lambda: CauseSettings(slack=1.15))
    robust: RobustSettings = field(
        default_factory=lambda: RobustSettings(ms_worst=1.95, ms_third=1.85, hidden_share=0.1)
    )
    guard: GuardSettings = field(default_factory=GuardSettings)
    trial: TrialSettings = field(default_factory=TrialSettings)
    choice: ChoiceSettings = field(default_factory=ChoiceSettings)
    book: BookSettings = field(default_factory=BookSettings)
    pv_range: tuple[float, float] = EVERYWHERE
    units: VendorUnits | None = None

    def rounded(self, gains: PidGains) -> PidGains:
        """The set that the controller runs when it is given this one, or this one where it cannot hold it."""
        if self.units is None:
            return gains
        try:
            return self.units.rounded(gains)
        except ValueError:
            return gains

    def __post_init__(self) -> None:
        for name in ("sample_time_s", "pv_span", "band", "wait_s", "setpoint_weight", "filter_s"):
            value = getattr(self, name)
            if value is not None and type(value) is not float:  # of numpy, which JSON refuses in part
                object.__setattr__(self, name, float(value))
        if not 0.0 <= self.filter_s < math.inf:
            raise ValueError(f"filter_s = {self.filter_s} must be a finite number, 0 or more")

    def mode_of(self, region: int) -> Mode:
        """What may be done in a region, by index."""
        own = self.region_modes[region] if region < len(self.region_modes) else None
        return own or self.mode

    def locks_of(self, region: int) -> Locks:
        """What stays as it is in a region, by index."""
        own = self.region_locks[region] if region < len(self.region_locks) else None
        return self.locks if own is None else own


def demanded(settings: RetunerSettings) -> RetunerSettings:
    """One demand of robustness: settings whose every Ms limit follows from the guard's two, which a person sets.

        limit = default x nominal / 1.75     of what is asked of the process as it is known: cause, rule, choice, book
        limit = default x worst / 2.1        of what is asked of all that is plausible: rule, boundary, trial

    The defaults were made for the guard's own; there nothing changes. A boundary's limit that was set by itself stays.
    """
    usual, guard = GuardSettings(), settings.guard
    nominal, worst = guard.ms_nominal / usual.ms_nominal, guard.ms_worst / usual.ms_worst
    if nominal == worst == 1.0:
        return settings
    cause, robust, book = settings.cause, settings.robust, settings.book
    boundary = guard.ms_worst if guard.ms_border == usual.ms_border else guard.ms_border
    high = nominal * settings.diagnosis.cause.ms_high
    return replace(
        settings,
        guard=replace(guard, ms_border=boundary),
        cause=replace(cause, ms_high=nominal * cause.ms_high),
        diagnosis=replace(settings.diagnosis, cause=replace(settings.diagnosis.cause, ms_high=high)),
        robust=replace(
            robust,
            ms_nominal=nominal * robust.ms_nominal,
            ms_worst=worst * robust.ms_worst,
            ms_third=nominal * robust.ms_third,
        ),
        choice=replace(settings.choice, ms_limit=nominal * settings.choice.ms_limit),
        trial=replace(settings.trial, harmless_ms=worst * settings.trial.harmless_ms),
        book=replace(
            book,
            ms_high=nominal * book.ms_high,
            ms_good=nominal * book.ms_good,
            ms_tried=worst * book.ms_tried,
            cost=replace(book.cost, ms_bad=nominal * book.cost.ms_bad, ms_calm=nominal * book.cost.ms_calm),
        ),
    )
