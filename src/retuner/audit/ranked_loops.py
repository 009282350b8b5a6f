"""The outcome of an audit: the ranked list, loops that swing together, what changed; as a page, as JSON, as Parquet.

The page holds the rows of the list; each loop's trends stand in a file of their own and are loaded when it is opened,
so that ten thousand loops open as fast as ten. It needs no server and no network.

How the loops of each area of a plant ran, day by day or week by week: what reliability engineers report.
"""

import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from retuner.adaptive.audit.common_swing import CommonSwing, Swinging, common_swings, interactions
from retuner.adaptive.audit.loop_screen import DAY_S
from retuner.adaptive.audit.tracks import SwingTrack, TrendTrack, cascades, twins
from retuner.adaptive.audit.verdict import FOR_CONDITION, SWINGS, AuditAction
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.audit import AREA
from retuner.audit.catalogue import Catalogue
from retuner.audit.loop_row import OWN_SWING, SCHEMA, Row, is_fault, smaller
from retuner.drivers.historian.assumption import quoted
from retuner.files import write_whole
from retuner.report.what_if import page_script, panel_style
from retuner.schedule.controller_units import ControllerUnits
from retuner.schedule.late_dataclass import asdict, dataclass, field
from retuner.templates import palette

# ---- How the loops of each area of a plant ran, day by day or week by week

SHARES = ("in_automatic", "at_limits", "oscillating")
MEANS = (*SHARES, "reversals_per_day")
WHOLE = "all"


@dataclass
class PlantCourse:
    """Collects the courses of loops. area : pattern whose first group is the area in a tag."""

    area: str = AREA
    _found: dict[tuple[str, float, str], list[dict[str, float]]] = field(default_factory=lambda: defaultdict(list))

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
        return [
            {"area": area, "days": days, "begin": begin, "loops": len(told)}
            | {name: float(f"{sum(one[name] for one in told) / len(told):.4g}") for name in (*MEANS, "travel")}
            for area, days, begin in sorted(self._found, key=lambda at: (at[0] != WHOLE, at))
            if (told := self._found[area, days, begin])
        ]


TRACKS = "tracks"
NOT_LISTED = frozenset({"trend", "stretches", "what_if", "over_time", TRACKS})
"""What is large of a row: its pictures, and what only the comparison of loops needs."""
SWUNG = frozenset({str(cause) for cause in (*TUNING_CAUSES, Cause.EXTERNAL, Cause.UNKNOWN, Cause.STICTION)})
"""Causes that a swing in step with a root's takes the place of."""
OF_TUNING, OWN = (frozenset(map(str, some)) for some in (TUNING_CAUSES, OWN_SWING))
ROOT_SURE = 0.9  # how sure the root of a coherent group is
SMALL = 240  # points of a small picture
MOST_FIRST = 10  # loops that the page tells first, with the reason
AGAIN = "the same record as"  # begin of the action of a loop that was exported twice
WORSE = 1.5  # ratio of errors a day from which a loop became worse, or better: loads differ from month to month


def ranked(rows: Iterable[Row], before: Sequence[Row] = ()) -> tuple[list[Row], list[CommonSwing]]:
    """Rows without pictures, the loop to visit first at the top, with their groups and changes.

    rows : of an audit. before : of an earlier one, to say what changed.
    """
    listed: list[Row] = []
    swinging: list[Swinging] = []
    damped: list[Swinging] = []
    trends: dict[str, TrendTrack] = {}
    for row in rows:
        # what other loops are compared with, as arrays, which ten thousand loops need: one that swings, one that is too
        # strong by itself and whose oscillation dies away, and the trend, for the cascades
        tag, screen, tracks = str(row["tag"]), row.get("screen") or {}, row.get(TRACKS) or {}
        if tracks.get("damped") and row["cause"] in OWN:
            track: SwingTrack | None = SwingTrack.of_dict(tracks["damped"])
            damped.append(Swinging(tag, tracks["damped_s"], 0.0, own=True, track=track))
        if screen.get("period_s") and screen["swinging"] >= SWINGS:
            track = SwingTrack.of_dict(tracks["swing"]) if tracks.get("swing") else None
            own = row["cause"] in OF_TUNING
            swinging.append(
                Swinging(tag, screen["period_s"], _number(row, "harmonic"), _number(row, "sticks"), own, track)
            )
        if tracks.get("trend"):
            trends[tag] = TrendTrack.of_dict(tracks["trend"])
        listed.append({k: v for k, v in row.items() if k not in NOT_LISTED})
    # Loops that are others' records under another tag are told once, and are in no group
    found = twins(trends)
    by_tag = {str(row["tag"]): row for row in listed}
    again = {tag for tag, other in found.items() if mean_error(by_tag[tag]) == mean_error(by_tag[other])}
    for tag in again:
        row = by_tag[tag]
        row["action"], row["rank"], row["settings"] = f"{AGAIN} {found[tag]}", 0.0, None
        row["reason"] = f"{found[tag]} has the same values at the same times: exported twice"
    damped, swinging = ([one for one in some if one.tag not in again] for some in (damped, swinging))
    groups = [*interactions(damped), *common_swings(swinging)]
    masters = cascades({tag: trend for tag, trend in trends.items() if tag not in again})
    group_of = {tag: group for group in groups for tag in group.tags}
    earlier = {str(row["tag"]): row for row in before}
    for row in listed:
        # what other loops have to do with one: its group, its cascade
        group = group_of.get(str(row["tag"]))
        row["swings_with"] = [tag for tag in group.tags if tag != row["tag"]] if group else []
        row["root"] = group.root if group else None
        row["interaction"] = group.interaction if group else False
        row["master"] = masters.get(str(row["tag"]))
        row["slaves"] = sorted(slave for slave, master in masters.items() if master == row["tag"])
        if before:
            row["change"] = change(row, earlier.get(str(row["tag"])))
    _from_the_root(listed, group_of)
    # The slave of a cascade comes before its master; of loops that swing against each other one is slowed down
    for row in listed:
        sick = [tag for tag in row["slaves"] if is_fault(by_tag[tag])]
        if sick and is_fault(row):
            row["action"] = f"its slave {sick[0]} first, then {row['action']}"
            row["rank"] = 0.5 * _number(row, "rank")
        if row["interaction"] and row["cause"] in {str(Cause.EXTERNAL), str(Cause.UNKNOWN), *OWN}:
            against = ", ".join(row["swings_with"][:3])
            row["action"] = f"swings against {against}: slow one of them down"
            if row["cause"] in OWN:
                row["reason"] = f"it and {against} act on each other: both oscillate after every upset. {row['reason']}"
                row["settings"] = None
    listed.sort(key=lambda row: (-_number(row, "rank"), str(row["tag"])))
    for place, row in enumerate(listed, start=1):
        row["place"] = place
    return listed, groups


def _from_the_root(rows: Sequence[Row], group_of: Mapping[str, CommonSwing]) -> None:
    """What swings in step with a root comes from there: it is visited after it, and nothing in it is retuned before.

    The root's visit brings what half of the others' would.
    """
    by_tag = {str(row["tag"]): row for row in rows}
    for row in rows:
        group = group_of.get(str(row["tag"]))
        if group is None or group.root is None or not is_fault(row):
            continue
        if group.root == row["tag"]:
            # What others swing with is not sent upstream by itself: there is nobody it comes from
            if row["cause"] == str(Cause.EXTERNAL):
                row["action"] = str(AuditAction.LOOK)
                row["reason"] = (
                    f"others oscillate in step with it, probably caused here: {group.why}; by itself: {row['reason']}"
                )
            continue
        if row["cause"] in SWUNG and group.coherence is not None:
            row["reason"] = f"oscillates in step with {group.root} ({group.why}); by itself: {row['reason']}"
            row["cause"], row["settings"] = str(Cause.EXTERNAL), None
            row["confidence"] = max(_number(row, "confidence"), group.coherence * ROOT_SURE)
        if row["cause"] == str(Cause.EXTERNAL):
            row["action"] = f"look at {group.root} first"
            row["rank"] = 0.5 * _number(row, "rank")
            root = by_tag[group.root]
            root["rank"] = _number(root, "rank") + _number(row, "rank")
            root["upsets"] = int(_number(root, "upsets")) + 1


def _number(row: Row, name: str) -> float:
    return float(row.get(name) or 0.0)


def change(row: Row, earlier: Row | None) -> str:
    """What became of a loop since an earlier audit, in some words.

    Faults that came or went, and the error on record: both are told alike by all versions of a row. A loop that was not
    diagnosed both times is compared by its error alone: how far an audit looked is no change of the loop.
    """
    if earlier is None:
        return "new"
    error, before = mean_error(row), mean_error(earlier)
    times = error / before if error is not None and before else 1.0
    moved = f"{'worse' if times > 1 else 'better'}: error {times:.2g} times" * (times > WORSE or times * WORSE < 1)
    # a row says what a loop is where it is neither screened only, nor unreadable, nor another loop's record
    open_still = (AuditAction.SCREENED, AGAIN)
    missing = " or ".join(
        when
        for one, when in ((earlier, "then"), (row, "now"))
        if "failed" in one or str(one.get("action", "")).startswith(open_still)
    )
    if missing:
        return f"{moved}{', ' * bool(moved)}not diagnosed {missing}"
    now, then = is_fault(row), is_fault(earlier)
    if now != then:
        return f"{'worse' if now else 'better'}: was {earlier['cause']}"
    return moved or ("same" if row["cause"] == earlier["cause"] else f"was {earlier['cause']}")


def write_joined(path: Path, found: Catalogue) -> None:
    """How names were joined to loops, as a file that --record takes back after somebody has mended it."""
    lines = [
        "# How the audit joined names to loops. Correct what is wrong and give it back with --record; a name that is",
        '# no signal gets "". Rules by the last word of names do the same for many: words = { meas = "pv" }',
        "[record]",
        "words = {}",
        "[record.signals]",
    ]
    for tag, roles in sorted(found.signals.items()):
        lines += [f"{quoted(name)} = {quoted(f'{tag}.{role.upper()}')}" for role, name in sorted(roles.items()) if tag]
    lines += ["", "# Names that belong to no loop:", *(f'# {quoted(name)} = ""' for name in found.others)]
    write_whole(path, "\n".join(lines) + "\n")


def summary(rows: Sequence[Row], refused: int) -> str:
    """The audit in some sentences: what deserves a visit, what is in order, what cannot be told or was not judged."""
    calm = {str(Cause.OK), str(Cause.NOISE)}
    visits = Counter(_kind_of_visit(row) for row in rows if is_fault(row))
    worth, quiet = sum(visits.values()), sum(row["cause"] in calm for row in rows)
    broken = sum("failed" in row for row in rows)
    screened = sum(row["action"] == str(AuditAction.SCREENED) for row in rows)
    again = sum(str(row["action"]).startswith(AGAIN) for row in rows)
    quiet -= sum(row["cause"] in calm and str(row["action"]).startswith(AGAIN) for row in rows)
    untold = len(rows) - worth - quiet - broken - screened - again
    kinds = ", ".join(f"{count} {kind}" for kind, count in visits.most_common())
    told = [f"{worth} of {len(rows)} loops deserve a visit{': ' * bool(kinds)}{kinds}"]
    for count, one, many, what in (
        (quiet, "is", "are", "in order"),
        (untold, "shows", "show", "too little to judge; each says what would help"),
        (screened, "was", "were", "screened only; nothing conspicuous"),
        (again, "is", "are", "another loop's record again"),
        (broken, "could", "could", "not be judged"),
        (refused, "file is", "files are", "no record"),
    ):
        told += [f"{count} {one if count == 1 else many} {what}"] * bool(count)
    return ". ".join(told) + "."


def _kind_of_visit(row: Row) -> str:
    """What is to be done, without the names of other loops."""
    if row.get("root") not in {None, str(row["tag"])}:
        return "wait for another loop"
    return "retune against each other" if row.get("interaction") else str(row["action"]).split(" first, then ")[-1]


def about(rows: Iterable[Row], sources: Sequence[Path]) -> dict[str, object]:
    """What an audit is of: its folders, the time that its records span where they have a calendar, when, by what."""
    spans = [(str(row["begin"]), str(row["end"])) for row in rows if row.get("begin")]
    return {
        "sources": [str(path) for path in sources],
        "begin": min((span[0] for span in spans), default=None),
        "end": max((span[1] for span in spans), default=None),
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        "program": f"retuner {version('retuner')}",
    }


def write_results(
    folder: Path,
    rows: Iterable[Row],
    before: Sequence[Row],
    refused: Sequence[tuple[Path, str]],
    sources: Sequence[Path] = (),
    area: str = AREA,
    controller: ControllerUnits | None = None,
) -> list[Row]:
    """Write the page, audit.json, and audit.parquet where pyarrow is installed; the ranked rows.

    folder : of the audit. rows : of its loops. before : of an earlier audit. refused : files with the reason. sources :
    what was audited. area : pattern of the area in a tag. controller :
    whose settings the page shows, None for gain and seconds.
    """
    course = PlantCourse(area)
    listed, groups = ranked(_with_pictures(folder, rows, course), before)
    document = {
        "schema": SCHEMA,
        "summary": summary(listed, len(refused)),
        "about": about(listed, sources),
        "rows": listed,
        "groups": [asdict(group) for group in groups],
        "over_time": course.to_list(),
        "refused": [{"file": str(path), "reason": reason} for path, reason in refused],
    }
    write_whole(folder / "audit.json", json.dumps(document, indent=1, allow_nan=False) + "\n")
    page = {**document, "rows": [_for_the_page(row, folder) for row in listed], "since": bool(before)}
    page["controller"] = {"name": controller.name, "span": controller.pv_span} if controller is not None else None
    write_whole(folder / "audit-data.js", "const AUDIT = " + _script(page) + ";\n")
    template = files("retuner.templates").joinpath("audit.html").read_text(encoding="utf-8")
    whole = template.replace("/*STYLE*/", palette() + panel_style()).replace("/*WHAT-IF*/", page_script())
    write_whole(folder / "index.html", whole)
    _write_parquet(folder / "audit.parquet", listed)
    return listed


def _with_pictures(folder: Path, rows: Iterable[Row], course: PlantCourse) -> Iterable[Row]:
    """The rows, each written with its trends into a file of its own on the way, its course into the plant's.

    A power cut may cost such a file, not the row: the same command writes it again.
    """
    (folder / "loops").mkdir(exist_ok=True)
    for number, row in enumerate(rows, start=1):
        row["file"] = f"{number}.js"
        course.add(row)
        shown = {name: value for name, value in row.items() if name != TRACKS}
        (folder / "loops" / f"{number}.js").write_text(f"loop({_script(shown)});\n", encoding="utf-8")
        yield row


def _script(value: object) -> str:
    return (
        json.dumps(value, allow_nan=False)
        .replace("<", "\\u003c")
        .replace("\u2028", "\\u2028")
        .replace("\u2029", "\\u2029")
    )


def _for_the_page(row: Row, folder: Path) -> Row:
    """What the list shows of a loop; folder : of its file, from which the first have a picture."""
    screen = row.get("screen") or {}
    shown = ("place", "tag", "cause", "confidence", "action", "avoidable", "basis", "since", "change", "file")
    looked_at = _number(row, "looked_at")
    share = _number(row, "seen") / looked_at if looked_at and row.get("seen") else None
    told = {name: row[name] for name in ("master", "slaves", "swings_with", "root", "upsets") if row.get(name)}
    if is_fault(row) and _number(row, "place") <= MOST_FIRST:
        # the stretch that shows its cause most surely, out of its file, as a small picture; else its whole trend
        text = (folder / "loops" / str(row["file"])).read_text(encoding="utf-8")
        whole = json.loads(text.removeprefix("loop(").removesuffix(");\n"))
        own = [part for part in whole.get("stretches") or [] if part["cause"] == whole["cause"]]
        best = max(own, key=lambda part: float(part["confidence"]), default=whole)
        look = smaller(best["trend"], SMALL) if best.get("trend") else None
        told |= {"why": row.get("reason", ""), "look": look}
    # The cause, or the condition of a record in which no loop is at work
    condition = screen.get("condition")
    known = row["cause"] != str(Cause.UNKNOWN) or row.get("confidence") is None
    told["cause"] = str(row["cause"] if known or condition not in {str(c) for c in FOR_CONDITION} else condition)
    told |= {"error": error} if (error := mean_error(row)) is not None else {}
    # share of co's travel that would go with the settings proposed
    found = (row.get("process") or {}).get("foreseen") if row.get("settings") else None
    told |= {"calmer": calmer} if (calmer := float(found["calmer"]) if found else None) else {}
    return {name: row.get(name) for name in shown} | {"period_s": screen.get("period_s"), "seen_share": share} | told


def mean_error(row: Row) -> float | None:
    """The mean |sp - pv| of a loop in the unit of pv; None where it is not known."""
    a_day = (row.get("screen") or {}).get("iae_per_day")
    return a_day / DAY_S if a_day is not None else None


def _write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """The list as a table, one level deep; nothing where pyarrow is not installed."""
    try:
        import pyarrow as pa  # noqa: PLC0415  an extra, loaded when wanted
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        return
    columns: dict[str, list[object]] = {}
    for place, row in enumerate(rows):
        told = {f"screen_{k}": v for k, v in (row.get("screen") or {}).items()}
        told |= {k: v for k, v in row.items() if not isinstance(v, (Mapping, list))}
        for name in told.keys() - columns.keys():
            columns[name] = [None] * place
        for name, values in columns.items():
            values.append(told.get(name))
    first = [name for name in rows[0] if name in columns] if rows else []
    pq.write_table(pa.table({name: columns[name] for name in dict.fromkeys([*first, *sorted(columns)])}), path)
