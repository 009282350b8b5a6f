"""Settings of setpoint bumps. All of them stand in the configuration file, below [adaptation.bumps]."""

from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.schedule.late_dataclass import dataclass

HOURS = 24.0


@dataclass(frozen=True, slots=True)
class BumpSettings:
    """Settings of setpoint bumps; the others mean nothing where it is not allowed.

    Raises ValueError: a setting is outside its range.
    """

    allowed: bool = False
    percent: float = setting(
        1.0,
        "Size of a bump: percent of the range of pv, to one side of the setpoint as it is",
        "0.1..5 %",
        "small beside what operators do",
    )
    after_h: float = setting(
        48.0, "Hours without evidence before a bump", "0..10000 h", "two days: every shift has had its say"
    )
    from_h: float = setting(0.0, "Hour of the day from which a bump may begin", f"0..{HOURS} h", "user")
    to_h: float = setting(HOURS, "Hour of the day until which; before from_h: over midnight", f"0..{HOURS} h", "user")
    most_per_day: int = setting(
        1, "Bumps in 24 hours at the most", "1..100 bumps", "hardly noticed among the day's moves"
    )
    most: int = setting(10, "Bumps of a session at the most", "1..10000 bumps", "what they do not show, more will not")
    announce_s: float = setting(
        600.0,
        "A bump is announced so long beforehand; whoever moves the setpoint meanwhile puts it off",
        "0..86400 s",
        "time to look and to say no",
    )
    longest_s: float = setting(14400.0, "A bump is removed after so long at the latest", "0.01..1e6 s", "half a shift")
    least_bands: float = setting(4.0, "Noise bands that a bump must have, or nothing would be learned by it", "2..100")
    excursion: float = setting(
        4.0, "A control error of so many times what a bump and the usual loads make together ends the bump", "1.5..20"
    )

    def __post_init__(self) -> None:
        require_in_range(self, "bumps")

    def is_time(self, hour: float) -> bool:
        """Whether a bump may begin at this hour of the day, 0 to 24."""
        if self.from_h <= self.to_h:
            return self.from_h <= hour < self.to_h
        return hour >= self.from_h or hour < self.to_h
