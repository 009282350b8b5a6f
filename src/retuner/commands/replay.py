"""retuner replay: decide again from a session's recorded frames, or ask what would have been done on another log."""

import json
import sys
from pathlib import Path

from retuner.errors import UserError
from retuner.replay.replaying import Replay, Replayed
from retuner.session.recorded_session import RecordedSession, read_session
from retuner.session.session_identity import differences


def replay(target: Path, *, config: Path | None, columns: str, as_json: bool) -> int:
    """Replay a session (status 0: byte for byte the same, 1: not), or a log with a configuration (status 0).

    Raises
    ------
    UserError, RecordingError
        The session, log or configuration cannot be used.
    """
    if config is not None:
        from retuner.commands.what_if import what_if  # noqa: PLC0415  only one of both ways is gone

        return what_if(target, config, columns, as_json=as_json)
    if target.is_file() and target.suffix != ".sqlite":
        raise UserError(f"{target}: is not the folder of a session; to replay a log of another origin give --config")
    if columns:
        raise UserError("--columns: names the columns of a log; a session has its own")
    session = read_session(target)
    result = Replay(session).run()
    if as_json:
        sys.stdout.write(json.dumps(document(session, result), indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.writelines(f"{line}\n" for line in told(session, result))
    return 0 if result.identical else 1


def document(session: RecordedSession, result: Replayed) -> dict[str, object]:
    """The result as one JSON document."""
    return {
        "session": str(session.folder),
        "identical": result.identical,
        "samples": result.samples,
        "compared": result.compared,
        "first_difference": result.difference.to_dict() if result.difference else None,
        "reason": result.stopped or None,
        "other_versions": differences(session.versions),
        "decisions": [decision.to_dict() for decision in result.decisions],
    }


def told(session: RecordedSession, result: Replayed) -> list[str]:
    """The result in lines for a person."""
    counted = f"{result.compared} decision{'s' * (result.compared != 1)} on {result.samples:,} samples"
    if result.identical:
        ongoing = "" if session.end is not None else " (the session was killed, or goes on)"
        return [f"{session.folder}: identical: {counted}, byte for byte as recorded{ongoing}"]
    if result.difference is None:
        return [f"{session.folder}: not compared to the end: {result.stopped}; {counted} are as recorded"]
    d = result.difference
    place = f"row {d.row}" if d.row else "not in the ledger"
    lines = [
        f"{session.folder}: different: decision {d.decision} ({place}), {d.key or 'the decision itself'}: "
        f"recorded {d.recorded!r}, replayed {d.replayed!r}; {max(result.compared - 1, 0)} decisions before it are equal"
    ]
    others = differences(session.versions)
    if others:
        lines.append(f"byte identity is claimed for equal versions only; others here: {'; '.join(others)}")
    return lines
