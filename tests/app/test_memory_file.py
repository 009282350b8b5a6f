"""A session that was killed goes on with what it had learned: whatever the moment, as far as the ledger knows."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from effort import sized
from recorded import SHORT

from retuner import LoopSample, Mode, Retuner, load_config
from retuner.adaptive.supervision.state_file import region_model_out
from retuner.config.model import Config
from retuner.ledger import Ledger
from retuner.session import memory_file
from retuner.session.assembly import make_retuner, retuner_settings
from retuner.session.ledger_rows import gains_of
from retuner.session.loop_session import LoopSession
from retuner.session.memory_file import MemoryFile, NoMemoryError, about, recall, started_with
from retuner.session.outputs import LEDGER, MEMORY, MEMORY_BEFORE, believed_rows
from retuner.session.running import Run


class KilledError(BaseException):
    """The process ends here."""


class Life:
    """One run in simulated time that keeps its memory, and may be killed at its n-th row or file."""

    def __init__(self, folder: Path, config: Config, fuse: int = 1 << 30) -> None:
        folder.mkdir(parents=True)
        self.folder, self.config, self.fuse = folder, config, fuse
        self.known: list[dict[str, Any]] = []  # models after each decision that the ledger has
        self.session: LoopSession | None = None
        self.ledger = Ledger(folder / LEDGER)

    def record(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        self.burn()
        self.ledger.append(kind, {"samples": 0, **body}, t_s)
        if kind == "decision" and self.session is not None:
            self.known.append(models(self.session.retuner))

    def burn(self) -> None:
        self.fuse -= 1
        if self.fuse <= 0:
            raise KilledError

    def live(self) -> "Life":
        run = Run(self.config, self.record, mode=Mode.AUTO, folder=None)
        memory = MemoryFile(self.folder, self.config, self.record)
        with run.bench() as (whole, bench):
            self.session = session = whole.loops[0]

            def save(t_s: float) -> None:
                self.burn()
                memory.save(session.retuner, t_s)

            session.remember = save
            try:
                while not session.finished:
                    bench.turn()
                    session.poll(bench.clock.now_s())
            except KilledError:
                pass
            finally:
                self.ledger.close()
        return self


def models(retuner: Retuner) -> dict[str, Any]:
    """What is known, as plain values."""
    return {str(region): region_model_out(model) for region, model in retuner.region_models.items()}


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Config:
    path = tmp_path_factory.mktemp("config") / "short.toml"
    path.write_text(SHORT)
    return load_config(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, config: Config) -> Life:
    """A life that nobody ended."""
    life = Life(tmp_path_factory.mktemp("whole") / "run", config).live()
    assert len(life.known) >= 2
    return life


def recalled(folder: Path, config: Config) -> Retuner:
    return recall(folder, config, retuner_settings(config, Mode.AUTO)).retuner


def test_what_a_finished_session_has_learned_is_what_the_next_one_begins_with(whole: Life, config: Config) -> None:
    again = recalled(whole.folder, config)
    assert models(again) == whole.known[-1]
    assert again.table == whole.session.table
    assert again.table.revision >= 1
    assert again.commissioned == whole.session.retuner.commissioned


@pytest.mark.slow
def test_killed_at_any_row_or_file_the_next_session_knows_what_the_ledger_knows(tmp_path, config, whole):
    points = len(believed_rows(whole.folder / LEDGER)) + len(whole.known)
    without: list[tuple[int, str]] = []
    for fuse in range(1, points + 1, sized(6, 6, 1)):
        life = Life(tmp_path / f"killed-{fuse}", config, fuse).live()
        rows = believed_rows(life.folder / LEDGER)
        decided = sum(row.kind == "decision" for row in rows)
        try:
            again = recalled(life.folder, config)
        except NoMemoryError as error:
            without.append((decided, str(error)))
            continue
        allowed = [{}, *whole.known][decided : decided + 2]
        assert models(again) in allowed
        told = [gains_of(row.body["gains"]) for row in rows if row.kind in {"committed", "restore"}]
        assert again.table.gains_of(0) in [again.commissioned.gains_of(0), *told]
        after = [row.kind for row in rows]
        after = after[len(after) - after[::-1].index("memory") :]
        unknown = [r for r in again.trials.undecided if again.trials.phase(r).name == "WRITING"]
        assert not unknown or not {"committed", "refused", "dropped"} & {*after}  # the controller will tell
    assert without
    assert all(decided == 0 and (not line or "no memory with this hash" in line) for decided, line in without)


def copied(whole: Life, to: Path) -> Path:
    to.mkdir()
    for path in whole.folder.iterdir():
        (to / path.name).write_bytes(path.read_bytes())
    return to


def torn(folder: Path) -> None:
    for name in (MEMORY, MEMORY_BEFORE):
        (folder / name).write_bytes((folder / name).read_bytes()[:100])


def forged(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    """A memory that says something else, with the ledger's blessing."""

    def do(folder: Path) -> None:
        document = json.loads((folder / MEMORY).read_text())
        change(document)
        text = json.dumps(document)
        (folder / MEMORY).write_text(text)
        with Ledger(folder / LEDGER) as ledger:
            ledger.append("memory", {"sha256": memory_file.digest(text), "samples": 0}, 0.0)

    return do


@pytest.mark.slow
@pytest.mark.parametrize(
    ("harm", "line"),
    [
        (torn, "it is damaged or was changed"),
        (forged(lambda d: d["memory"].update(version=3)), "memory version 3 is not"),
        (forged(lambda d: d.update(about="0")), "it belongs to another configuration"),
        (forged(lambda d: d["memory"].pop("trials")), "the memory is damaged"),
        (forged(lambda d: d["memory"].update(rounding=10**400)), "the memory is damaged"),
        (forged(lambda d: d.pop("memory")), "it is damaged"),
        (lambda folder: (folder / LEDGER).write_bytes(b"no ledger"), "ledger.sqlite"),
    ],
)
def test_a_memory_that_cannot_be_trusted_is_named_in_one_line(tmp_path, whole, config, harm, line):
    folder = copied(whole, tmp_path / "copy")
    harm(folder)
    with pytest.raises(NoMemoryError) as told:
        recalled(folder, config)
    assert line in str(told.value)
    assert "\n" not in str(told.value)
    assert str(told.value).endswith("the loop begins without memory")


def test_without_an_earlier_session_nothing_is_said(tmp_path: Path, config: Config) -> None:
    for before in (None, tmp_path):
        with pytest.raises(NoMemoryError, match=r"^$"):
            recall(before, config, retuner_settings(config))


def test_another_configuration_begins_without_memory(whole: Life, config: Config) -> None:
    other = config.model_copy(update={"loop": config.loop.model_copy(update={"tau_f_s": 1.0})})
    with pytest.raises(NoMemoryError, match="another configuration"):
        recalled(whole.folder, other)


def test_a_memory_of_an_earlier_release_is_still_of_the_same_configuration(config: Config) -> None:
    """A new key with a default must not enter the hash: every memory, and every replay from one, would be refused.

    So must not the proposal that a schedule was taken from. It changed with the default of tau_i_samples.
    """
    taken = config.model_copy(update={"schedule": config.schedule.model_copy(update={"proposal": "0" * 64})})
    for same in (config, taken):
        assert about(same) == "e5fd10ca53cb758b960070e781576992142aebe2d142c56e594b6f106a430434"


def test_the_session_that_goes_on_is_replayed_from_what_it_began_with(tmp_path, whole, config):
    settings = retuner_settings(config, Mode.AUTO)
    remembered = recall(whole.folder, config, settings)
    next_one = Life(tmp_path / "next", config)
    MemoryFile(next_one.folder, config, next_one.record).begin(remembered, "")
    next_one.ledger.close()
    rows = believed_rows(next_one.folder / LEDGER)
    begun = started_with(next_one.folder, rows, config, settings)
    assert models(begun.retuner) == models(remembered.retuner)
    assert begun.last_s == remembered.last_s
    sample = LoopSample((begun.last_s or 0.0) + 1.0, 2.0, 2.0, 30.0, 1, 0, 2.0)
    assert begun.retuner.observe(sample) == remembered.retuner.observe(sample)


def test_a_disk_that_refuses_is_told_in_a_row_and_the_session_goes_on(tmp_path, config, monkeypatch):
    def refuse(path: Path, content: str) -> None:
        raise OSError(28, f"No space left on device for {len(content)} characters", str(path))

    life = Life(tmp_path / "full", config)
    monkeypatch.setattr(memory_file, "write_whole", refuse)
    MemoryFile(life.folder, config, life.record).save(make_retuner(config), 1.0)
    life.ledger.close()
    (row,) = believed_rows(life.folder / LEDGER)
    assert row.body["sha256"] is None
    assert "No space left on device" in row.body["reason"]
