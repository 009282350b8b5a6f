"""The layer of the law: from sample to sample co is what the page's formula gives, also where a set is swapped in."""

from bus_simulation.layers.seen import Seen
from bus_simulation.layers.wire import broken
from retuner.drivers.controller.virtual_device import VirtualDevice

RELATIVE, ABSOLUTE = 1e-5, 1e-3  # the firmware counts in float32; the largest gains here are 100


class Law:
    """co foretold from the sample before, where neither end of the range was touched.

    device : whose pv, setpoint and output are looked at.
    """

    def __init__(self, device: VirtualDevice) -> None:
        self._device = device
        self.restarted()

    def restarted(self) -> None:
        """Power came back, at rest."""
        self._pv, self._rate = self._device.pv, 0.0
        self._integral: float | None = None  # of the next sample; None where a limit had its say

    def sampled(self, before: Seen, after: Seen, dt_s: float) -> None:
        """A sample of dt_s seconds: co is what it would have been under the gains before, whatever runs now."""
        s, k = self._device.settings, before.running.gains
        pv, sp, co = self._device.pv, after.sp, self._device.co
        rate = (s.tau_f_s * self._rate + pv - self._pv) / (s.tau_f_s + dt_s)
        if self._integral is not None and s.co_rate_per_s is None and after.auto:
            wish = k.kp * (s.b * sp - pv) + self._integral - k.kd * rate
            size = abs(k.kp) * (abs(sp) + abs(pv)) + abs(self._integral) + abs(k.kd) * (abs(pv) + abs(self._pv)) / dt_s
            aim = min(max(wish, s.co_min), s.co_max)
            if abs(co - aim) > RELATIVE * size + ABSOLUTE:
                raise broken("output_follows_the_law", f"co is {co}, {aim} follows from the sample before, under {k}")
        self._pv, self._rate = pv, rate
        s, k = self._device.settings, after.running.gains
        more = k.ki * (after.sp - self._pv) * dt_s
        inside = s.co_min < co < s.co_max and s.co_min < co + more < s.co_max
        integral = co - k.kp * (s.b * after.sp - self._pv) + k.kd * self._rate + more
        self._integral = integral if inside and after.auto else None
