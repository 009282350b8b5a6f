"""What the host knows of a foreign controller beside its numbers: its pace, its ranges, its patience."""

from retuner.drivers.recorded.sample_note import NOTES
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field

TIMES = ("sample_time_s", "reply_s", "silent_s", "connect_s", "feed_s", "look_s")


@dataclass(frozen=True, slots=True)
class ForeignSettings:
    """How to treat a controller.

    gains : set that it is believed to run where it cannot be asked.
    where : the device in words. sample_time_s : time between samples, s. variable : as CanDeviceSettings.
    co_min, co_max : range of the output, percent. sp_start : setpoint until one was sent, where it reports none.
    reply_s : longest wait for an answer. silent_s : age of the last frame at which it counts as silent. connect_s :
    longest wait for the first connection. feed_s : the setpoint is sent again after so long, which feeds a watchdog.
    look_s : its gains are read again after so long. closed : why gains are never written, "" when they are.
    bench_node : number of a virtual one, which takes loads; None for a real one. after_s : as CanDevice.
    note_id : identifier under which its samples are noted in the log (sample_note.py).

    Raises ValueError: a time is not a positive finite number.
    """

    gains: PidGains
    where: str = "device"
    sample_time_s: float = 1.0
    variable: str | ScheduleInputs = "sp"
    co_min: float = 0.0
    co_max: float = 100.0
    sp_start: float = 0.0
    reply_s: float = 0.5
    silent_s: float = 6.0
    connect_s: float = 20.0
    feed_s: float = 1e9
    look_s: float = 60.0
    closed: str = ""
    bench_node: int | None = None
    after_s: float | None = field(default=None)
    note_id: int = NOTES

    def __post_init__(self) -> None:
        for name in TIMES:
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"device: {name} = {getattr(self, name)}; give a positive number of seconds")
