"""Settings of the odds."""

from retuner.adaptive.explanations.likely_processes import WorthSettings
from retuner.adaptive.explanations.tuning_odds import TuningLimits
from retuner.schedule.late_dataclass import dataclass, field, fields


@dataclass(frozen=True, slots=True)
class OddsSettings:
    """Settings.

    ok, aggressive, slow_integrating, sluggish : prior of each class of tuning, sum 1. Of loops in automatic half are
        acceptable (Desborough & Miller 2002: 32 of 64 %; fewer in Bialkowski 1993), the rest are too tight or too slow
        in about equal parts; of the tight ones a level loop has too little gain for its integral action more often
        than too much. With a third in order, as before, records that say little were called in order or sluggish by
        chance: of 49 loops in order under real loads 19 were called otherwise, 12 are.
    stiction : prior that a valve which sticks or has play is behind a record; 0.1 to 0.4, default 0.25 (20 to 30 % of
        loops oscillate because of their valve: Jelali & Huang 2010).
    repeats : prior of a load from outside that steps to and fro or goes up and down in ramps, at even times: the limit
        cycle of a valve elsewhere, behind its process; 0.01 to 0.2, default 0.05.
    nonlinear : prior that the gain changes along pv by two and more within the record's range; 0.01 to 0.1, default
        0.03; no more gain is given where the records leave it larger odds.
    steps_weight : power of the Bayes factor of a tone, and of a fit that leaves the noise alone; 0.5 to 3, default 2.5:
        the tempered likelihood was too doubtful where the truth was known (benchmarks/world).
    shapes_say : how many times likelier a record is by a valve where shapes and plateaus named one; 2 to 20, default 6
        (9 of 25 sticking valves named, 2 of 75 other loops, under real loads). stands_slips : the same where pv stands
        while co travels and then slips; 10 to 100, default 40 (no false alarm on 31 healthy tags and 250 further
        records). stands : where it stands and a drifting load may do so too; 2 to 30, default 6 (of 20 sticking
        valves under real loads 2 stood, of 60 other loops 12, most of them under the output of a sticking valve).
    valve_fits : the same where a fitted valve leaves far less than loop and tone do; 5 to 50, default 20.
    noise_left : what a tone with few_loads load steps or fewer may leave, in times the noise, and be at least as likely
        as not, whatever its harmonics cost; 1 to 1.5, default 1.15. few_loads : 0 to 4, default 2.
    tone_alone : probability, at the most, of a tone from outside beside a load that wanders, where it does not leave
        the noise alone; 0.5 to 0.95, default 0.6 (of 5 loops under real loads where it was likelier than any walk it
        was behind none).
    tone_from, tone_to : share of pv's variance in one lasting tone from which, and up to which, a record without a
        setpoint step is taken for that tone; 0.2 to 1, default 0.4 and 0.6 (loops near instability under real loads
        0 to 0.38 in 28 of 29, tones and narrow bands 0.41 to 1).
    smooths : prior that a recorder has smoothed pv and co by averages or lines; 0.02 to 0.3, default 0.1.
    most : no probability is told larger; 0.9 to 0.99, default 0.97: more was never counted.
    due_odds : odds of the causes that ask for a change from which settings are given; 0.5 to 0.9, default 0.6 (of 290
        loops in order or behind a valve under real loads none had over 0.53; benchmarks/world, seeds 11201 to 12206;
        since T_LOADS is 8, two of 60 were given some: 12413, 12417).
        loads_odds : the same for more by loads alone, and for less where an oscillation lasts and no setpoint step was
        made; 0.7 to 0.97, default 0.85, as on line (BookSettings.less_odds; of 28 good loops under a load that swings
        in a narrow band four had 0.6 to 0.75, two had more). moved : share of the setpoint in what moves the records
        from which it is not loads alone; 0.05 to 0.3, default 0.1.
    most_valve : odds of a valve up to which settings are given; 0.05 to 0.3, default 0.25.
    identified_ms, identified_most : Ms that the settings of a model with a drift may not have, and on what share of the
        odds; 1.8 to 4, default 2.5, and 0.05 to 0.5, default 0.3 (of 504 drawn loops, sets that held had it on 26 % at
        the most, those that did not on 37 % and more).
    undecided : a test is proposed where the most probable cause has less than this, and before loads alone change
        gains; 0.7 to 0.95, default 0.9.
    most_held : rows for which a coarse pv stands still that are averaged into one; 1 to 20, default 8.
    most_windows : windows of a long record, or of several, that are compared; 2 to 20, default 4 (of each record).
    """

    ok: float = 0.4
    aggressive: float = 0.21
    slow_integrating: float = 0.1
    sluggish: float = 0.29
    stiction: float = 0.25
    nonlinear: float = 0.03
    repeats: float = 0.05
    steps_weight: float = 2.5
    shapes_say: float = 6.0
    stands_slips: float = 40.0
    stands: float = 6.0
    valve_fits: float = 20.0
    noise_left: float = 1.15
    few_loads: int = 2
    tone_alone: float = 0.6
    tone_from: float = 0.4
    tone_to: float = 0.6
    smooths: float = 0.1
    most: float = 0.97
    due_odds: float = 0.6
    most_valve: float = 0.25
    moved: float = 0.1
    loads_odds: float = 0.85
    identified_ms: float = 2.5
    identified_most: float = 0.3
    undecided: float = 0.9
    most_held: int = 8
    most_windows: int = 4
    limits: TuningLimits = field(default_factory=TuningLimits)
    worth: WorthSettings = field(default_factory=WorthSettings)

    def __post_init__(self) -> None:
        if abs(sum(self.prior.values()) - 1.0) > 1e-9 or min(self.prior.values()) <= 0:
            raise ValueError(f"the priors of ok, aggressive, slow_integrating and sluggish {self.prior} must sum to 1")
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, float) and not 0 < value < 100:
                raise ValueError(f"{one.name} = {value} is not a number above 0")

    @property
    def prior(self) -> dict[str, float]:
        """Prior of each class of tuning."""
        return {name: getattr(self, name) for name in ("ok", "aggressive", "slow_integrating", "sluggish")}
