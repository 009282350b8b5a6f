"""What is known of a region's process, as values: by structure, with what the last records said by themselves."""

from collections.abc import Sequence

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.region_model.co_curve import CoCurve
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.signals.setpoint_steps import SetpointSteps
from retuner.schedule.late_dataclass import dataclass, field

POINTS = 12  # Records, the last ones, that are remembered by what they said alone


@dataclass(frozen=True, slots=True)
class StructureModel:
    """What is known under one structure: parameters with covariance, and the evidence for it (smaller is better)."""

    log: LogModel
    evidence: float


@dataclass(frozen=True, slots=True)
class RecordPoint:
    """One record by itself: when, where, and what it said.

    t_s : of its last sample. x, x2 : scheduling variables there (x2 is 0 for a table of one dimension).
    log : the structure that explains this record best, fitted to it alone. innovation : how far it lay from what was
    known before (chi-square, one degree of freedom a parameter), 0 for the first. co_curve : what it said of how co
    acts, None where nothing. told : see steady_drift.py.
    """

    t_s: float
    x: float
    x2: float
    log: LogModel
    innovation: float
    co_curve: CoCurve | None = None
    told: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class RegionModel:
    """What is known of a region.

    known : by structure, the leading one first. records : how many records are in it, 0 for a borrowed one.
    t_s : when it was last updated.
    alternative : what the contradicting record alone said, if the last one was odd.
    points : the last POINTS records by themselves, oldest first. plausible : models that the posterior still allows,
    by likelihood, the best first. identifiable : whether settings may follow from it; reason says why or why not.
    windows : the records themselves while they are few, for the next one to be fitted with them (update.py).
    sequences : setpoint steps to and fro that were made here (sequences.py); the newest last.
    bound_s : dead time that settings rest on where none is seen (dead_time_bound.py); 0 where it is seen.
    """

    known: tuple[StructureModel, ...]
    records: int
    t_s: float
    alternative: tuple[StructureModel, ...] | None = None
    points: tuple[RecordPoint, ...] = field(default=())
    plausible: tuple[Plausible, ...] = field(default=())
    identifiable: bool = True
    reason: str = ""
    windows: tuple[Window, ...] = ()
    sequences: tuple[SetpointSteps, ...] = ()
    bound_s: float = 0.0

    @property
    def log(self) -> LogModel:
        """The leading structure's."""
        return self.known[0].log.at_bound(self.bound_s)


def remembered(points: Sequence[RecordPoint], latest: RecordPoint) -> tuple[RecordPoint, ...]:
    """The points with the latest, at most POINTS of them."""
    return (*points, latest)[-POINTS:]
