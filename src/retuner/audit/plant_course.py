"""How the loops of each area of a plant ran, day by day or week by week: what reliability engineers report."""

import re
from collections import defaultdict
from dataclasses import dataclass, field

from retuner.adaptive.audit.verdict import SWINGS
from retuner.audit import AREA
from retuner.audit.loop_row import Row

SHARES = ("in_automatic", "at_limits", "oscillating")
MEANS = (*SHARES, "reversals_per_day")
WHOLE = "all"


@dataclass
class PlantCourse:
    """Collects the courses of loops. area : pattern whose first group is the area in a tag."""

    area: str = AREA
    _found: dict[tuple[str, float, str], list[dict[str, float]]] = field(default_factory=lambda: defaultdict(list))
    _travel: dict[str, float] = field(default_factory=dict)

    def add(self, row: Row) -> None:
        """A loop's row, where it has a course. Its travel is told over its own mean: co has no unit that all share."""
        course = row.get("over_time")
        if not isinstance(course, dict):
            return
        found = re.search(self.area, str(row["tag"]))
        areas = (WHOLE, *((found.group(1),) if found and found.groups() and found.group(1) else ()))
        travel = course["travel_per_day"]
        usual = sum(travel) / len(travel)
        for i, begin in enumerate(course["begin"]):
            told = {name: float(course[name][i]) for name in ("in_automatic", "at_limits", "reversals_per_day")}
            told |= {
                "oscillating": float(course["swinging"][i] >= SWINGS),
                "travel": travel[i] / usual if usual else 1.0,
            }
            for area in areas:
                self._found[area, float(course["days"]), begin].append(told)

    def to_list(self) -> list[dict[str, object]]:
        """A document for each area and part of time, the plant as a whole first.

        Keys: area, days (length of the part), begin, loops, and means over them: in_automatic, at_limits, oscillating
        (shares), reversals_per_day, travel (over each loop's own mean).
        """
        places = sorted(self._found, key=lambda at: (at[0] != WHOLE, at))
        return [
            {"area": area, "days": days, "begin": begin, "loops": len(told)}
            | {name: float(f"{sum(one[name] for one in told) / len(told):.4g}") for name in (*MEANS, "travel")}
            for area, days, begin in places
            if (told := self._found[area, days, begin])
        ]
