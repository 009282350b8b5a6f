"""Chooses the order in which a controller that swaps nothing at once is written, and keeps why in the ledger."""

import math
from collections.abc import Callable, Mapping

from retuner.adaptive.guard.write_order import gentlest_way, proved_way
from retuner.adaptive.supervision.known_processes import still_allowed
from retuner.adaptive.supervision.retuner import Retuner
from retuner.drivers.device import WriteRefusedError
from retuner.schedule.vendor_units import VendorUnits

Record = Callable[[str, float, Mapping[str, object]], None]  # what keeps a row for good: its kind, the time, the body


def order_of_writes(
    retuner: Retuner, units: VendorUnits, record: Record, now: Callable[[], float], *, unproved: bool
) -> Callable[[Mapping[str, float], Mapping[str, float], bool], tuple[int, ...]]:
    """What chooses the messages in their order, from the set that runs to the one that shall, and whether it is the way
    back. It raises WriteRefusedError: no order is proved, and this is neither the way back nor accepted by the user.

    retuner : what is known of the process. units : how the controller keeps gains. record : keeps rows for good.
    now : time of the newest sample. unproved : the user accepts an order that no model proves.
    """

    def chosen_way(old: Mapping[str, float], new: Mapping[str, float], back: bool) -> tuple[int, ...]:
        ways, s = list(units.ways(old, new)), retuner.settings
        region, proved = retuner.region, None
        known = None if region is None else retuner.region_models.get(region)
        if region is not None:
            models = () if known is None else still_allowed(known, now(), s)
            ends = units.of(old), units.of(new)
            proved = proved_way(ways, ends, models, s.sample_time_s, s.guard.ms_worst, s.filter_s)
        chosen = proved or (gentlest_way(ways) if back or unproved else None)
        if chosen is None and known is not None:
            raise WriteRefusedError(
                f"the controller takes the gains in several messages; in none of {len(ways)} orders is every step "
                f"proved (Ms at most {s.guard.ms_worst:g} on every plausible model)"
            )
        if chosen is None:
            raise WriteRefusedError(
                "the controller takes the gains in several messages, and no model of this region proves the steps "
                'between; accept that by name: [device] accept = ["unproved_order"]'
            )
        body = {
            "messages": list(chosen.messages),
            "proved": proved is not None,
            "ms_between": None if math.isnan(chosen.ms_worst) else chosen.ms_worst,
        }
        record("order_of_writes", now(), body)
        return chosen.messages

    return chosen_way
