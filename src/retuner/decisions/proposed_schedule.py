"""Another schedule that a session's own records ask for: what it is, its hash, and the row of the ledger that keeps it.

The row stands where the session ends. A replay works the proposal out again from what it has learned by then, so the
row says no more than the frames do. A person takes it up by `retuner approve`, which writes it into a configuration
under its hash. A run of that configuration says in its first row where its schedule came from.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from retuner.adaptive.supervision.retuner import Retuner
from retuner.config.model import Config
from retuner.products import product
from retuner.schedule.config_section import schedule_section
from retuner.schedule.document import to_toml
from retuner.schedule.regions import CAN
from retuner.schedule.table import GainTable

if TYPE_CHECKING:
    from retuner.adaptive.region_model.proposed_boundaries import Refinement

ROW = "schedule"  # kind of the row


def refined(retuner: Retuner) -> "Refinement | None":
    """The schedule that the records ask for, at the time of the newest of them; None where the present one does."""
    held = (*retuner.settings.region_modes, *retuner.settings.region_locks)
    if any(axis.variable == CAN for axis in retuner.table.regions.axes) or any(one is not None for one in held):
        return None  # a region that somebody holds stays as it is; a signal's message stands in the configuration alone
    models, now_s = retuner.region_models, max((one.t_s for one in retuner.region_models.values()), default=0.0)
    found: Refinement | None = product("another schedule").proposed_boundaries(
        retuner.table, models, now_s, retuner.settings.sample_time_s, retuner.settings.tracker
    )
    return found


def digest_of(table: GainTable) -> str:
    """The hash of a schedule: SHA-256 of the section that runs it, in hexadecimal digits."""
    return hashlib.sha256(schedule_section(table).encode()).hexdigest()


def row_body(found: "Refinement", samples: int, loop: str = "") -> dict[str, object]:
    """What the row says.

    samples : that the session had seen of the loop. loop : its name where there are several.
    """
    named = {"loop": loop} if loop else {}
    proposed = {"hash": digest_of(found.table), "table": to_toml(found.table)}
    return {**named, **proposed, "reason": found.sentence, "proposal": found.to_dict(), "samples": samples}


def same_proposal(body: Mapping[str, Any], found: "Refinement | None", *, rounded: bool) -> bool:
    """Whether a row is what these records ask for.

    rounded : another engine has worked it out, which is equal to rounding only; then the sets are counted.
    """
    if found is None:
        return False
    if rounded:
        return bool(len(body["proposal"]["gains"]) == len(found.table.gains))
    again = {"hash": digest_of(found.table), "proposal": json.loads(json.dumps(found.to_dict()))}
    return again == {name: body[name] for name in again}


def taken_up(loops: Iterable[Config]) -> list[dict[str, object]]:
    """Which loops run a schedule that a session proposed: its hash, and whether it stands as it was proposed."""
    return [
        {"loop": one.loop.name, "hash": one.schedule.proposal, "as_proposed": stands(one)}
        for one in loops
        if one.schedule.proposal
    ]


def stands(config: Config) -> bool:
    """Whether the schedule is the one whose hash it carries."""
    return digest_of(config.gain_table()) == config.schedule.proposal
