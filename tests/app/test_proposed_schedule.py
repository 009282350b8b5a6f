"""A schedule that a session's records ask for: a row of its ledger, decided again by a replay, taken up by a person."""

import json
import re
import shutil
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import printed, refused
from recorded import SHORT, bodies, rewritten, run_short

from retuner import GainTable, PidGains, Regions
from retuner.adaptive.region_model import proposed_boundaries
from retuner.adaptive.region_model.proposed_boundaries import Refinement
from retuner.adaptive.schedule_design.places import DesignLimits
from retuner.cli import main
from retuner.commands.approve import _full_hash, places
from retuner.config.loading import load_session
from retuner.config.model import Config
from retuner.decisions.proposed_schedule import digest_of, taken_up
from retuner.errors import UserError
from retuner.files import write_whole
from retuner.gain_export.schedule_into_config import schedule_into
from retuner.ledger import Row
from retuner.report.ledger_words import told
from retuner.schedule.config_section import schedule_section

EXAMPLES = Path(__file__).parents[2] / "examples"
REGIONS = Regions("sp", "bar", ("part 1", "part 2"), 1.0, (2.5,), 9.0, 0.1)
OTHER = GainTable("short", REGIONS, (PidGains(4.0, 1.0), PidGains(3.123456789, 0.8)), revision=1)

ONE = GainTable(
    "short", Regions.along(("all",), replace(REGIONS.axes[0], low=0.0, bounds=(), high=10.0)), OTHER.gains[:1]
)


def proposal(table: GainTable = OTHER) -> Refinement:
    return Refinement(table, 10, 6, 10, 2.2, 1.7, DesignLimits())


def asking_for(patch: pytest.MonkeyPatch, found: Refinement | None) -> None:
    """What the records of every session ask for."""
    patch.setattr(proposed_boundaries, "proposed_boundaries", lambda *_: found)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose records ask for another schedule."""
    with pytest.MonkeyPatch.context() as patch:
        asking_for(patch, proposal())
        return run_short(tmp_path_factory.mktemp("proposing"))


def test_it_is_a_row_before_the_end_and_files_beside_the_report(session: Path) -> None:
    (row,) = bodies(session, "schedule")
    assert row["hash"] == digest_of(OTHER)
    assert "Another schedule serves more places" in row["reason"]
    assert row["proposal"]["bounds"] == [2.5]
    assert (session / "refined-schedule.toml").read_text() == schedule_section(OTHER)
    summary = json.loads((session / "summary.json").read_text())
    assert any(one["kind"] == "refine" for one in summary["advice"])
    (line,) = told([Row(7, 1.0, "schedule", json.dumps(row), "", "")])
    assert (line.who, line.verdict) == ("retuner", "proposed")


def test_the_ledger_ends_with_the_command_that_takes_it_up(session: Path) -> None:
    assert "open: to take up the schedule that the records ask for; retuner approve" in printed(
        "ledger", "show", session
    )


@pytest.mark.slow
def test_a_replay_asks_again(session, monkeypatch):
    asking_for(monkeypatch, proposal())
    assert "identical" in printed("replay", session)
    asking_for(monkeypatch, proposal(OTHER.with_gains(1, PidGains(3.2, 0.8))))
    assert "different" in printed("replay", session, status=1)
    asking_for(monkeypatch, None)
    assert main(["replay", str(session)]) == 1


def test_a_person_takes_it_up_and_the_next_run_says_so(session, tmp_path):
    digest, config = digest_of(OTHER)[:8], tmp_path / "short.toml"
    shutil.copy(session.parent / "short.toml", config)
    assert digest in printed("approve", session)
    assert "--into" in refused("approve", session, digest)
    before = config.read_text()
    assert main(["approve", str(session), digest, "--into", str(config), "--by", "Ada", "--note", "so be\nit"]) == 0
    text = config.read_text()
    assert "approved by Ada" in text
    assert "# the command line may say more" in text  # what else stands there stays
    found = load_session(config)[0].loops[0]
    assert found.gain_table().regions.bounds == (2.5,)
    assert taken_up([found]) == [{"loop": "short", "hash": digest_of(OTHER), "as_proposed": True}]
    edited = tmp_path / "edited.toml"
    edited.write_text(text.replace("bounds = [2.5]", "bounds = [2.6]"))
    assert not taken_up(load_session(edited)[0].loops)[0]["as_proposed"]
    config.write_text(before)
    assert taken_up(load_session(config)[0].loops) == []


@pytest.mark.slow
def test_a_run_of_it_begins_its_ledger_with_that(session: Path, tmp_path: Path) -> None:
    config = tmp_path / "short.toml"
    shutil.copy(session.parent / "short.toml", config)
    ran = load_session(session / "config.toml")[0].loops[0]
    text = schedule_into(config, OTHER, ran, "as proposed").text
    config.write_text(text.replace("duration_s = 80.0", "duration_s = 50.0"))
    assert main(["run", str(config), "--out", str(tmp_path / "next"), "--no-compare", "--mode", "off"]) == 0
    (begun,) = bodies(tmp_path / "next", "session")
    assert begun["schedules"] == [{"loop": "short", "hash": digest_of(OTHER), "as_proposed": True}]
    (line,) = told([Row(1, 0.0, "session", json.dumps(begun), "", "")])
    assert "as proposed" in line.verdict


def test_what_is_not_a_proposed_schedule_is_not_taken_up(session: Path, tmp_path: Path) -> None:
    def forged(row: Any) -> dict[str, Any] | None:
        body: dict[str, Any] = json.loads(row.text)
        return {**body, "table": "schema = 9"} if row.kind == "schedule" else body

    broken = rewritten(session, tmp_path / "broken", forged)
    config = tmp_path / "short.toml"
    shutil.copy(session.parent / "short.toml", config)
    before = config.read_text()
    assert main(["approve", str(broken), digest_of(OTHER)[:8], "--into", str(config)]) == 2
    assert main(["approve", str(session), "--into", str(config)]) == 2
    assert config.read_text() == before


def test_the_section_of_one_of_several_loops_is_its_own(tmp_path: Path) -> None:
    config = tmp_path / "boiler_house.toml"
    shutil.copy(EXAMPLES / "boiler_house.toml", config)
    loops = load_session(config)[0].loops
    own = loops[1].gain_table()
    axis = own.regions.axes[0]
    half = (axis.low + axis.high) / 2
    regions = Regions("sp", axis.unit, ("part 1", "part 2"), axis.low, (half,), axis.high)
    table = GainTable(own.loop, regions, (own.gains[0],) * 2, revision=1)
    config.write_text(schedule_into(config, table, loops[1], "as proposed").text)
    after = load_session(config)[0].loops
    assert after[1].gain_table().regions.bounds == (half,)
    assert [one.gain_table() for one in (after[0], after[2])] == [one.gain_table() for one in (loops[0], loops[2])]
    section = schedule_section(table, own.loop)
    assert section.splitlines()[1] == "[loop.schedule]"
    assert "[[loop.schedule.region]]" in section
    assert "\n[[schedule." not in section


@pytest.fixture
def ran(session: Path) -> Config:
    return load_session(session / "config.toml")[0].loops[0]


@pytest.mark.parametrize(
    ("was", "now", "told"),
    [
        ("tau_i_s = 4.0", 'tau_i_s = 4.0\nmode = "off"', "region 'all' has its own mode"),
        ("tau_i_s = 4.0", 'tau_i_s = 4.0\nlocked = ["kc"]', "region 'all' has its own locked"),
        ('name = "short"', 'name = "other"', "has the loop other, the proposal is for 'short'"),
        ("pv_max = 10.0", "pv_max = 100.0", "loop.pv_max is 100.0, the session ran with 10.0"),
        ('"bar"', '"kPa"', "loop.pv_unit is kPa"),
        ("sample_time_s = 0.1", "sample_time_s = 0.2", "loop.sample_time_s is 0.2"),
        ('name = "all"', 'name = "one"', "has the regions one, the session ran all"),
        ('variable = "sp"', 'variable = "pv"', "its regions are of another variable"),
        ("kc = 5.0", "kc = 2.0", "the gains of region 'all' are neither those at the start"),
        ('variable = "sp"', 'lookup = "interpolated"', "schedule.lookup is interpolated"),
    ],
    ids=lambda it: it[:20],
)
def test_it_goes_only_where_its_records_came_from(tmp_path: Path, ran: Config, was: str, now: str, told: str) -> None:
    config = tmp_path / "short.toml"
    config.write_text(SHORT.replace(was, now))
    with pytest.raises(UserError, match=re.escape(told)):
        schedule_into(config, OTHER, ran, "")


def test_gains_that_the_session_left_are_its_own(tmp_path: Path, ran: Config) -> None:
    config = tmp_path / "short.toml"
    config.write_text(SHORT.replace("kc = 5.0", "kc = 2.0"))
    left = load_session(config)[0].loops[0].gain_table()
    assert schedule_into(config, OTHER, ran, "", left).text


def test_what_was_taken_up_is_not_taken_up_again(tmp_path: Path, ran: Config) -> None:
    config = tmp_path / "short.toml"
    config.write_text(SHORT)
    config.write_text(schedule_into(config, OTHER, ran, "").text)
    with pytest.raises(UserError, match="has this schedule already"):
        schedule_into(config, OTHER, ran, "")


def test_the_record_of_a_session_is_not_written_into(session: Path) -> None:
    before = (session / "config.toml").read_bytes()
    assert "name the configuration of the next run" in refused(
        "approve", session, digest_of(OTHER)[:8], "--into", session / "config.toml"
    )
    assert (session / "config.toml").read_bytes() == before


def test_comments_of_the_next_section_stay_and_others_are_counted(tmp_path: Path, ran: Config) -> None:
    config = tmp_path / "short.toml"
    below = "tau_i_s = 4.0\n\n# What the retuner may do.\n# Ask Ada first.\n"
    text = SHORT.replace('variable = "sp"', '# as in 2019\nvariable = "sp"  # quiet').replace("tau_i_s = 4.0\n", below)
    config.write_text(text)
    written = schedule_into(config, OTHER, ran, "note")
    assert "\n\n# What the retuner may do.\n# Ask Ada first.\n[adaptation]" in written.text
    assert "where the proposed" not in written.text
    assert (written.comments, "2019" in written.text) == (2, False)


def test_a_loop_without_a_section_of_its_own_gets_one_above_the_comments_of_the_next(tmp_path: Path) -> None:
    config = tmp_path / "two.toml"
    top = SHORT[SHORT.index("[schedule]") : SHORT.index("[device]")]
    loop = SHORT[SHORT.index("name =") : SHORT.index("[schedule]")]
    second = loop.replace("short", "long") + "[loop.bus]\nnode = 9\n"
    config.write_text(f"schema = 1\n{top}\n[[loop]]\n{loop}[loop.bus]\nnode = 8\n\n# The long one.\n[[loop]]\n{second}")
    loops = load_session(config)[0].loops
    text = schedule_into(config, ONE, loops[0], "").text
    assert "\n\n# The long one.\n[[loop]]\n" in text
    assert text.count("# The long one.") == 1
    assert schedule_into(config, replace(ONE, loop="long"), loops[1], "").text.startswith(config.read_text())


def test_line_ends_stay(tmp_path: Path, ran: Config) -> None:
    config = tmp_path / "short.toml"
    config.write_bytes(SHORT.replace("\n", "\r\n").encode())
    written = schedule_into(config, OTHER, ran, "note").text
    assert written.count("\n") == written.count("\r\n") > 20


def test_inline_loops_are_refused_in_one_line(tmp_path: Path) -> None:
    config = tmp_path / "inline.toml"
    loop = '{ name = "short", pv_unit = "bar", pv_min = 0.0, pv_max = 10.0, sample_time_s = 0.1, schedule = { region ='
    config.write_text(f'schema = 1\nloop = [{loop} [{{ name = "all", kc = 5.0, tau_i_s = 4.0 }}] }} }}]\n')
    with pytest.raises(UserError, match=re.escape("under [[loop]] and [loop.schedule]")):
        schedule_into(config, OTHER, load_session(config)[0].loops[0], "")


def test_regions_apart_from_their_section_are_refused_in_one_line(tmp_path: Path, ran: Config) -> None:
    config = tmp_path / "apart.toml"
    region = SHORT[SHORT.index("[[schedule.region]]") : SHORT.index("[adaptation]")]
    config.write_text(SHORT.replace(region, "") + region)
    with pytest.raises(UserError, match="write it in one place"):
        schedule_into(config, OTHER, ran, "")


def test_two_loops_of_one_proposal_are_told_apart_by_name(session: Path) -> None:
    (place,) = places(session)
    other = copy(place)
    place.name, other.name = "east", "west"
    with pytest.raises(UserError, match="east and west have this very proposal, name the loop with --loop"):
        _full_hash([place, other], digest_of(OTHER)[:8])


def test_an_unlock_takes_up_nothing(session: Path) -> None:
    assert "--into" in refused("approve", session, "--unlock", "all", "--into", str(session.parent / "short.toml"))
    assert not [*session.glob("orders/*")]


def test_a_file_keeps_its_permissions_and_a_protected_one_stays(tmp_path, monkeypatch):
    file = tmp_path / "loop.toml"
    file.write_text("old")
    file.chmod(0o640)
    write_whole(file, "new")
    assert (file.read_text(), file.stat().st_mode & 0o777) == ("new", 0o640)
    monkeypatch.setattr("retuner.files.os.access", lambda *_: False)
    with pytest.raises(PermissionError, match="may not be written"):
        write_whole(file, "newer")
    assert file.read_text() == "new"
