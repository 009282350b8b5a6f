"""What a person can do when a run has ended: lines for the screen, each command as it has to be typed."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from retuner.decision_page.explain import ms_words, short_settings
from retuner.ledger import Row
from retuner.report.scores import RegionScore
from retuner.session.order_queue import SHORT, shown


class Next(NamedTuple):
    """A thing to do: why, and the command; no command where there is only something to know."""

    why: str
    command: str = ""


def what_next(
    folder: Path, rows: Iterable[Row], approval_s: float, locked: Iterable[str], *, changed: bool
) -> list[Next]:
    """Proposals that wait, changes that wait for a word, locked regions, the gains to be written back, the report.

    rows : of the ledger. approval_s : how long a proposal is open. locked : regions that are locked out. changed :
    whether the table has other gains than at the start.
    """
    found, place = shown(rows), shlex.quote(str(folder))
    told = [
        Next(
            f"{one.region}: decision {one.number} proposes {short_settings(one.before)} -> {short_settings(one.after)}",
            f"retuner approve {place} {one.digest[:SHORT]}",
        )
        for one in found.open(approval_s)
        if not found.successor(one)
    ]
    told += [
        Next(f"{region}: tried and as promised; waits for a word", f"retuner approve {place} {digest[:SHORT]}")
        for region, digest in found.waiting.items()
    ]
    told += [
        Next(f"{region}: locked out after several undone changes", f"retuner approve {place} --unlock {region}")
        for region in locked
    ]
    if changed:
        told.append(Next(f"the gains as they are now: {folder / 'gains.toml'}"))
    return told


def narrow_scores(scores: Iterable[RegionScore], unit: str) -> list[str]:
    """Each region's result in two lines, for a narrow screen."""
    lines = []
    for s in scores:
        ms = "" if s.ms_after is None else f"; Ms {ms_words(s.ms_before)} -> {ms_words(s.ms_after)}"
        iae = f"IAE {s.iae:,.0f} {unit} s"
        iae += "" if s.iae_fixed is None else f" (fixed gains: {s.iae_fixed:,.0f})"
        lines.append(f"{s.region}: {short_settings(s.before)} -> {short_settings(s.after)}{ms}")
        lines.append(f"    {s.changes} writes; {iae}")
    return lines
