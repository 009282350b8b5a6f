"""retuner replay: decide again from a session's recorded frames, or ask what would have been done on another log."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor
from retuner.adaptive.supervision.decision import Decision, Mode, gains_dict
from retuner.adaptive.supervision.retuner import Retuner
from retuner.commands.options import FormOptions, tell
from retuner.commands.recorded.recorded_loop import read_record, renamed, tell_assumed
from retuner.commands.signatures import ReplayOptions
from retuner.config import Config, load_config
from retuner.decision_page.decision_words import one_line
from retuner.decision_page.shown_units import show_units_of
from retuner.drivers.recorded.frame_log import is_frame_log
from retuner.drivers.recorded.recorded_samples import (
    LoopFacts,
    Recorded,
    frame_samples,
    has_more_than_signals,
    recording_samples,
    table_samples,
)
from retuner.errors import UserError
from retuner.replay.replaying import Replay, ReplayedSession
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import fields
from retuner.schedule.plain_values import plain_values
from retuner.session.assembly import make_retuner, schedule_inputs
from retuner.session.outputs import RecordedSession, differences, read_loops
from retuner.verbosity import busy


def replay(options: ReplayOptions) -> int:
    """Replay a session or a log; the exit status."""
    target = options.target
    if options.config is not None:
        return what_if(target, options.config, options)
    if target.is_file() and target.suffix != ".sqlite":
        raise UserError(f"{target}: is not the folder of a session; to replay a log of another origin give --config")
    _refuse_form(options, "a session has its own")
    recorded, meant = read_loops(target)
    show_units_of(meant)
    if options.loop is not None:
        recorded = (recorded[meant.place(options.loop)],)
    # Decide again in each loop; the exit status
    with busy("deciding again"):
        results = [(one, Replay(one).run()) for one in recorded]
    identical, agreed = (all(getattr(one, name) for _, one in results) for name in ("identical", "agrees"))
    if options.as_json:
        documents = [document(one, result) for one, result in results]
        whole = documents[0] if len(documents) == 1 else {"identical": identical, "loops": documents}
        sys.stdout.write(json.dumps(whole, indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.writelines(f"{line}\n" for one, result in results for line in told(one, result))
    return 0 if agreed else 1


def _refuse_form(options: FormOptions, why: str) -> None:
    for field_ in fields(FormOptions):
        if getattr(options, field_.name) != field_.default:
            name = field_.name.replace("_", "-")
            raise UserError(f"--{name}: gives the form of a table; {why}")


def document(session: RecordedSession, result: ReplayedSession) -> dict[str, object]:
    """The result as one JSON document."""
    return {
        "session": str(session.folder),
        "loop": session.config.loop.name,
        **plain_values(result, "identical same_verdicts=agrees"),
        "engines": {"then": result.engines[0], "here": result.engines[1]} if result.engines else None,
        **plain_values(result, "samples compared first_difference=difference"),
        "reason": result.stopped or None,
        "other_versions": differences(session.versions),
        "decisions": [decision.to_dict() for decision in result.decisions],
    }


def told(session: RecordedSession, result: ReplayedSession) -> list[str]:
    """The result in lines for a person."""
    counted = f"{result.compared} decision{'s' * (result.compared != 1)} on {result.samples:,} samples"
    ongoing = "" if session.end is not None else " (the session was killed, or goes on)"
    if result.identical:
        return [f"{session.folder}: identical: {counted}, byte for byte as recorded{ongoing}"]
    if result.engines is not None and result.agrees:
        then, here = result.engines
        return [
            f"{session.folder}: the same verdicts: {counted}, by engine {here} instead of {then}; "
            f"{result.rounded} differ in rounding alone{ongoing}"
        ]
    if result.difference is None:
        return [f"{session.folder}: not compared to the end: {result.stopped}; {counted} are as recorded"]
    d = result.difference
    place = f"row {d.row}" if d.row else "not in the ledger"
    lines = [
        f"{session.folder}: different: decision {d.decision} ({place}), {d.key or 'the decision itself'}: "
        f"recorded {d.recorded!r}, replayed {d.replayed!r}; {max(result.compared - 1, 0)} decisions before it are equal"
    ]
    others = differences(session.versions)
    if result.engines is not None:
        lines.append(f"engine {result.engines[0]} then, {result.engines[1]} here: verdicts are compared, not bytes")
    if others:
        lines.append(f"byte identity is claimed for equal versions only; others here: {'; '.join(others)}")
    return lines


# replay LOG --config CONFIG: what would have been done on a log from anywhere. Nothing is written anywhere.

IN_FORCE_SAMPLES = 10
"""Samples after a boundary within which recorded gains do not count as the new region's: a schedule writes these a few
samples after the boundary was crossed."""


class InForce:
    """Follows the gains that a record says were in force, so that decisions are about the loop as it was."""

    def __init__(self, retuner: Retuner) -> None:
        self._retuner = retuner
        self._region: int | None = None
        self._stay = 0

    def adopt(self, gains: PidGains | None) -> bool:
        """Note the gains of a sample that the retuner has seen; whether its table was changed for them."""
        region = self._retuner.region
        self._stay = self._stay + 1 if region == self._region else 1
        self._region = region
        if gains is None or region is None or self._stay < IN_FORCE_SAMPLES:
            return False
        table = self._retuner.table
        if gains.direction != table.gains[region].direction:
            raise UserError("the record's gains act against the configured ones; is this the right configuration?")
        if any(change_factor(gains, known) <= SAME_GAINS for known in table.gains):
            return False
        self._retuner.committed(region, gains)
        return True


def what_if(log: Path, config_file: Path, options: ReplayOptions) -> int:
    """Say what would have been done on a log; the exit status, 0.

    Raises UserError, RecordingError: log or configuration cannot be used.
    """
    if log.is_dir():
        raise UserError(f"{log}: is a folder; a session is replayed without --config, a log is a file")
    config = load_config(config_file, options.loop)
    retuner = make_retuner(config, Mode.ADVISE)
    in_force, samples, decisions, changed_s = InForce(retuner), 0, list[Decision](), list[float]()
    with busy(f"deciding on {log}"):
        for samples, (sample, gains) in enumerate(recorded_loop(log, options, config), start=1):
            try:
                decision = retuner.observe(sample)
            except ValueError as error:
                raise UserError(f"sample {samples} of the log: {error}") from None
            decisions += [decision] if decision is not None else []
            changed_s += [sample.t_s] if in_force.adopt(gains) else []
    table, counted = retuner.table, f"{len(decisions)} decision{'s' * (len(decisions) != 1)}"
    lines = [f"{one.t_s:10,.0f} s  {one.region}: {one_line(one)}" for one in decisions]
    times = "once" if len(changed_s) == 1 else f"{len(changed_s)} times"
    changed = f", the record's gains changed {times}" if changed_s else ""
    whole = {
        "log": str(log),
        "config": str(config_file),
        "samples": samples,
        "decisions": [decision.to_dict() for decision in decisions],
        "gains_changed_s": changed_s,
        "gains": [
            {"region": name, **gains_dict(gains)} for name, gains in zip(table.regions.names, table.gains, strict=True)
        ],
    }
    last = f"{log}: {counted} on {samples:,} samples{changed}; nothing was written"
    tell(whole, [*lines, last], as_json=options.as_json)
    return 0


def recorded_loop(log: Path, options: FormOptions, config: Config) -> Iterator[Recorded]:
    """The samples of a log: bus traffic by its suffix, a table with what only a run's trend has, or any export."""
    loop = config.loop
    facts = LoopFacts(loop.sample_time_s, schedule_inputs(config), loop.co_min_pct, loop.co_max_pct, config.bus.node)
    if is_frame_log(log):
        _refuse_form(options, f"{log} is a log of bus traffic")
        return frame_samples(log, facts)
    if has_more_than_signals(log, renamed(options.columns)):
        return table_samples(log, renamed(options.columns), facts)
    read = read_record([log], options, in_automatic=True)
    tell_assumed(read.assumed, options)
    return recording_samples(read.recording, facts)
