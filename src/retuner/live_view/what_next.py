"""What a person can do when a run has ended: lines for the screen, each command as it has to be typed."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from retuner.decision_page.decision_words import ms_words, short_settings
from retuner.ledger import Row
from retuner.report.scores import RegionScore
from retuner.session.order_queue import SHORT, shown


class Next(NamedTuple):
    """A thing to do: why, and the command; no command where there is only something to know."""

    why: str
    command: str = ""


class Changed(NamedTuple):
    """A table that has other gains than at the start, and the configuration that they may go back into."""

    gains: Path
    config: Path


def what_next(
    folder: Path,
    rows: Iterable[Row],
    approval_s: float,
    locked: Iterable[str],
    changed: Changed | None,
    loop: str = "",
    *,
    by_hand: str = "",
) -> list[Next]:
    """Proposals that wait, changes that wait for a word, locked regions, the gains to be written back, the report.

    rows : of the ledger, about this loop. approval_s : how long a proposal is open. locked : regions that are locked
    out. changed : where the table is. loop : its name, where there are several. by_hand : why nothing is written to it.
    """
    found, place, of = shown(rows), shlex.quote(str(folder)), f"{loop}, " if loop else ""
    place += f" --loop {shlex.quote(loop)}" if loop else ""
    told = []
    for one in found.open(approval_s):
        if not found.successor(one):
            step = f"{short_settings(one.before, loop)} -> {short_settings(one.after, loop)}"
            why = f"{of}{one.region}: decision {one.number} proposes {step}"
            told.append(
                Next(f"{why}; {by_hand}") if by_hand else Next(why, f"retuner approve {place} {one.digest[:SHORT]}")
            )
    for region, digest in found.waiting.items():
        why = f"{of}{region}: trial passed, as predicted: awaiting operator approval"
        told.append(Next(why, f"retuner approve {place} {digest[:SHORT]}"))
    for region in locked:
        why = f"{of}{region}: locked after repeated rollbacks"
        told.append(Next(why, f"retuner approve {place} --unlock {shlex.quote(region)}"))
    for digest in found.schedules:
        where = shlex.quote(str(changed.config)) if changed is not None else "CONFIG"
        why = f"{of}to take up the schedule that the records ask for:"
        told.append(Next(why, f"retuner approve {place} {digest[:SHORT]} --into {where}"))
    if changed is not None:
        gains, config = (shlex.quote(str(path)) for path in changed)
        told.append(
            Next(f"{of}to put the final gains into the configuration:", f"retuner export {gains} --into {config}")
        )
    return told


def narrow_scores(scores: Iterable[RegionScore], unit: str, loop: str = "") -> list[str]:
    """Each region's result in two lines, for a narrow screen. loop : its name, where there are several."""
    lines = [f"{loop}:"] if loop else []
    for s in scores:
        ms = "" if s.ms_after is None else f"; Ms {ms_words(s.ms_before)} -> {ms_words(s.ms_after)}"
        iae = f"IAE {s.iae:,.0f} {unit} s"
        iae += "" if s.iae_fixed is None else f" (fixed gains: {s.iae_fixed:,.0f})"
        lines.append(f"{s.region}: {short_settings(s.before, loop)} -> {short_settings(s.after, loop)}{ms}")
        lines.append(f"    {s.changes} writes; {iae}")
    return lines
