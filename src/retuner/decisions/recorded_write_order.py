"""Chooses the order in which a controller that swaps nothing at once is written, and keeps why in the ledger."""

import math
from collections.abc import Callable, Mapping, Sequence

from retuner.adaptive.guard.write_order import ChosenWay, gentlest_way, proved_way
from retuner.adaptive.supervision.known_processes import still_allowed
from retuner.adaptive.supervision.retuner import Retuner
from retuner.drivers.device import WriteRefusedError
from retuner.schedule.gains import PidGains
from retuner.schedule.vendor_units import VendorUnits, Way

Record = Callable[[str, float, Mapping[str, object]], None]  # what keeps a row for good: its kind, the time, the body


class OrderOfWrites:
    """See the head of this file.

    retuner : what is known of the process. units : how the controller keeps gains. record : keeps rows for good.
    now : time of the newest sample. unproved : the user accepts an order that no model proves.
    """

    def __init__(
        self, retuner: Retuner, units: VendorUnits, record: Record, now: Callable[[], float], *, unproved: bool
    ) -> None:
        self._retuner, self._units, self._record, self._now, self._unproved = retuner, units, record, now, unproved

    def __call__(self, old: Mapping[str, float], new: Mapping[str, float], back: bool) -> tuple[int, ...]:
        """The messages in their order.

        Raises WriteRefusedError: no order is proved, and this is neither the way back nor accepted by the user.
        """
        ways = list(self._units.ways(old, new))
        proved = self._proved(ways, (self._units.of(old), self._units.of(new)))
        chosen = proved or (gentlest_way(ways) if back or self._unproved else None)
        if chosen is None:
            raise WriteRefusedError(self._why(ways))
        body = {
            "messages": list(chosen.messages),
            "proved": proved is not None,
            "ms_between": None if math.isnan(chosen.ms_worst) else chosen.ms_worst,
        }
        self._record("order_of_writes", self._now(), body)
        return chosen.messages

    def _proved(self, ways: Sequence[Way], ends: tuple[PidGains, PidGains]) -> ChosenWay | None:
        retuner, s = self._retuner, self._retuner.settings
        region = retuner.region
        if region is None:
            return None
        known = retuner.region_models.get(region)
        models = () if known is None else still_allowed(known, self._now(), s)
        return proved_way(ways, ends, models, s.sample_time_s, s.guard.ms_worst, s.filter_s)

    def _why(self, ways: Sequence[Way]) -> str:
        region = self._retuner.region
        if region is not None and region in self._retuner.region_models:
            return (
                f"the controller takes the gains in several messages; in none of {len(ways)} orders is every step "
                f"proved (Ms at most {self._retuner.settings.guard.ms_worst:g} on every plausible model)"
            )
        return (
            "the controller takes the gains in several messages, and no model of this region proves the steps between; "
            'accept that by name: [device] accept = ["unproved_order"]'
        )
