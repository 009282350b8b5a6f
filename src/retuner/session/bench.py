"""Where an experiment takes place: on the virtual device in simulated time, or on a bus in real time.

Both are a device and a turn: let some time pass and say what time it is. The turn of the live bus may be interrupted,
that of the simulated one not, because device and host share a thread there.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from retuner.config import Config
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import MonotonicClock
from retuner.experiment.runner import Bench
from retuner.session.assembly import link_settings
from retuner.session.devices import make_device
from retuner.session.running import POLLS_PER_SAMPLE, virtual_bench
from retuner.stopping import unstoppable


@contextmanager
def simulated(config: Config, log: Path | None = None) -> Iterator[Bench]:
    """The configured virtual device, a sample a turn.

    Raises
    ------
    UserError, DeviceError
        The configuration has no [device], or the bus log cannot be opened.
    """
    with virtual_bench(config, log) as (near, clock, sample):

        def turn() -> float:
            with unstoppable():
                clock.advance(config.loop.sample_time_s)
                sample()
            return clock.now_s()

        yield Bench(make_device(config, near), turn)


@contextmanager
def live(config: Config, speed: float, log: Path | None = None) -> Iterator[Bench]:
    """Whatever answers on the configured bus, some turns a sample.

    Raises
    ------
    DeviceError
        The bus does not open.
    """
    clock = MonotonicClock(speed)
    with CanLink(link_settings(config, speed), clock, log) as link:
        device = make_device(config, link, speed)

        def turn() -> float:
            link.wait_until(clock.now_s() + config.loop.sample_time_s / POLLS_PER_SAMPLE)
            return clock.now_s()

        try:
            yield Bench(device, turn)
        finally:
            device.release(clock.now_s())
