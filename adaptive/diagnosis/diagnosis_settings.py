"""Settings of diagnosis."""

from retuner.adaptive.diagnosis.cause import CauseSettings
from retuner.adaptive.fit.misfit import WHITE
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.identification.robust_simc import RobustSettings
from retuner.adaptive.identification.structure_choice import LEAD, ON_LINE, StructureSettings
from retuner.adaptive.valve.stand_still import StandStillSettings
from retuner.schedule.late_dataclass import dataclass, field, replace


@dataclass(frozen=True, slots=True)
class DiagnosisSettings:
    """Settings.

    saturated_share : share of samples at a limit of co from which saturation is the cause; 0.1 to 0.8, default 0.25.
    least_lead : by how much the criterion of an external tone or a stuck valve must be the smaller one;
        5 to 100, default 20 (odds of e^10). lead_per_sample : and by so much per sample; default 0.02.
    tone_explains : a tone that leaves no more than this many times the noise has explained the record, and a valve
        must do better; 1.05 to 1.5, default 1.15 (no limit cycle is as regular).
    stuck_handicap : where it leaves more, a valve may leave so many times as much: its band differs from stop to stop,
        and the scan may miss it; 1 to 2.5, default 1.6.
    stuck_handicap_triangle : the same where the half waves of co are triangles, which only what moves in jumps makes
        of them; 1 to 5, default 3.
    jump_share : share of pv's travel in its largest jumps beyond co's, from which an irregular valve is told where no
        single band explains the record; 0.02 to 0.3, default 0.04 (real flow loops 0.05 to 0.21, levels below 0.02).
    stuck_helps : a valve must leave less than this share of what the loop by itself leaves; 0.5 to 1, default 0.87.
    turns_per_change : a valve that turns no more than so many times for each setpoint change goes where it is sent;
        1 to 3, default 2.
    fewest_turns : of a valve with one stick band; 3 to 6, default 4: two reversals give its band and its jump, and only
        those after them can confirm it.
    confirming_turns : where pv stands for long between slips that are no faster than the loop, so many turns are
        needed; 6 to 20, default 10 (a load's slow triangle under a fast loop draws the same for a few rounds).
        slow_rounds : and this is how long pv stands for that, in tau_I; 15 to 60, default 30.
    slips_asked : what a tone must leave, in times the noise, for a valve of free slips to be asked; default 1.15.
        slips_explain : what that may leave itself; 1.5 to 4, default 2.4. fewest_slips : default 4.
        slips_travel : of co while the valve stands, in its ranges; 1 to 4, default 2.
    rival_explains : a tone that leaves more than this many times the noise is none; 1.2 to 5, default 2.
    oscillating_residual : a linear explanation that leaves more than this many times the noise is put against its
        rivals even where nothing oscillates regularly; 1.05 to 3, default 1.12.
    explained : a change of gains needs a remainder within this many times the noise; 1.1 to 3, default 1.5.
    explained_steps : the same where several setpoint steps agree; 1.5 to 10, default 3.
    tone_as_good : a change of gains needs that a tone leaves no less than this share of what the loop by itself
        leaves; 0.8 to 1, default 0.95. tone_as_good_loads : the same where only load steps excite it; default 0.98.
        tone_odds : unless its criterion is the larger one by this much; 0 to 60, default 5 (odds of e^2.5 against it: a
        sinusoid that a loop's own swing does not need has 8 to 12).
    tone_cycles : of a tone that is believed where the loop's own explanation leaves the cause open; default 3.
        tone_size : and its amplitude in standard deviations of pv; 0.2 to 1.2, default 0.4.
    many_loads : load steps from which a record is taken to be disturbed all along; 3 to 12, default 5.
        many_loads_beside : the same beside setpoint steps, where these are not more; default 4 (a slipping valve looks
        like loads).
    spread_limit : largest spread of ln |C| over the plausible models with which the cause may still be told where
        identification alone would not give settings; 0.2 to 1, default 0.5.
    second_explained : what a fit may leave, in times the noise, for a doubt by load steps or by a tone to be put to a
        second opinion; 1 to 2, default 1.2. second_loads : load steps that this may need; 0 to 3, default 1.
    explained_alone : share of pv's movement beyond its noise that a verdict by load steps alone must explain; 0.7 to
        0.98, default 0.9.
    waves_a_load : half waves that each load step must have begun for a swing without a setpoint step to be called the
        loop's own; 1.5 to 4, default 2 (the first is the load's).
    most_overshoot : of setpoint responses, in a loop that is in order for all that they show; default 0.25.
        in_order_explained : share of pv's variance that its models must explain; default 0.9.
    play_asked : by how much the criterion of a linear explanation may be the larger one for a valve with play to be
        looked for from it as well; 0 to 200, default 60.
    held_share : share of the samples in gaps that were filled with the last values, of pv and co at once, from which
        nothing is said of the tuning; 0.05 to 0.5, default 0.15 (real records with such gaps: 0.19 to 0.54).
    majority : weight of the models that must share a verdict that changes gains; 0.5 to 0.99, default 0.75.
    in_auto : the samples say that the loop is in automatic, so that a co which stands still is no sign of manual.
    by_odds : a tone, and models that do not agree, are weighed by odds (cause_odds/) and are no doubt of a verdict.
    """

    saturated_share: float = 0.25
    least_lead: float = 20.0
    lead_per_sample: float = 0.02
    tone_explains: float = 1.15
    stuck_handicap: float = 1.6
    stuck_handicap_triangle: float = 3.0
    jump_share: float = 0.04
    stuck_helps: float = 0.87
    turns_per_change: float = 2.0
    fewest_turns: int = 4
    confirming_turns: int = 10
    slow_rounds: float = 30.0
    slips_asked: float = 1.15
    slips_explain: float = 2.4
    fewest_slips: int = 4
    slips_travel: float = 2.0
    rival_explains: float = 2.0
    oscillating_residual: float = 1.12
    explained: float = 1.5
    explained_steps: float = 3.0
    tone_as_good: float = 0.95
    tone_as_good_loads: float = 0.98
    tone_odds: float = 5.0
    tone_cycles: float = 3.0
    tone_size: float = 0.4
    many_loads: int = 5
    many_loads_beside: int = 4
    spread_limit: float = 0.5
    second_explained: float = 1.2
    second_loads: int = 1
    explained_alone: float = 0.9
    waves_a_load: float = 2.0
    most_overshoot: float = 0.25
    in_order_explained: float = 0.9
    play_asked: float = 60.0
    held_share: float = 0.15
    majority: float = 0.75
    in_auto: bool = False
    by_odds: bool = False
    fit: FitSettings = field(
        default_factory=lambda: FitSettings(
            StructureSettings(most_loads=6, most_order=WHITE, further=(LEAD,)), most_samples=2000
        )
    )
    identified: FitSettings = field(default_factory=FitSettings)
    cause: CauseSettings = field(default_factory=lambda: CauseSettings(slack=2.4, weak=10.0))
    robust: RobustSettings = field(default_factory=RobustSettings)
    standing: StandStillSettings = field(default_factory=StandStillSettings)

    def on_line(self) -> "DiagnosisSettings":
        """The same on line: one sample tells automatic, and no lead is looked for (structure_choice.py)."""
        fit = replace(self.fit, choice=replace(self.fit.choice, further=()))
        return replace(self, in_auto=True, fit=fit, identified=replace(self.identified, choice=ON_LINE))
