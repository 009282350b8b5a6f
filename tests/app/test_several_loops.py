"""Several loops in one session: each as if it were alone, one ledger, and everything names the loop."""

import json
from pathlib import Path
from typing import Any

import pytest

from retuner.cli import main
from retuner.commands.check import described
from retuner.config.loading import UnusableError, parse_session, text_as_run
from retuner.config.session_config import SessionConfig
from retuner.ledger import LedgerReader
from retuner.session.outputs import loop_folder, read_loops

TEXT = (Path(__file__).parent / "several.toml").read_text(encoding="utf-8")
SLOW, FAST = "slow one", "fast"
IN_STEP = TEXT.replace("sample_time_s = 1.0", "sample_time_s = 2.0")
"""Both make their samples at the same moments, so the host looks at each as often as if it were alone."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both loops in one run."""
    folder = tmp_path_factory.mktemp("several")
    (folder / "two.toml").write_text(IN_STEP)
    assert main(["run", str(folder / "two.toml"), "--no-compare", "--out", str(folder / "run")]) == 0
    return folder / "run"


def bodies(session: Path, kind: str, loop: str) -> list[dict[str, Any]]:
    with LedgerReader(session / "ledger.sqlite") as ledger:
        return [row.body for row in ledger.rows() if row.kind == kind and row.body.get("loop") == loop]


def test_each_loop_decides_what_it_decides_alone(session: Path, tmp_path: Path) -> None:
    found = parse_session(IN_STEP)
    for i, name in enumerate((SLOW, FAST)):
        alone = text_as_run(IN_STEP, SessionConfig((found.loops[i],)), {})
        (tmp_path / f"{i}.toml").write_text(alone)
        assert main(["run", str(tmp_path / f"{i}.toml"), "--no-compare", "--out", str(tmp_path / f"{i}")]) == 0
        decided = bodies(session, "decision", name)
        assert decided == bodies(tmp_path / f"{i}", "decision", name)
        assert [one["action"] for one in decided] == [["commit", "restore"], ["advise"]][i]


def test_each_loop_has_its_mode_its_folder_and_its_rows(session: Path) -> None:
    assert [body["why"] for body in bodies(session, "committed", SLOW)] == ["retune"]  # the cure stays
    assert bodies(session, "committed", FAST) == []
    assert [body["action"] for body in bodies(session, "decision", FAST)] == ["advise"]
    assert loop_folder(session, SLOW).name == "slow-one"
    for name in (SLOW, FAST):
        assert {"gains.toml", "report.html", "trend.csv"} <= {one.name for one in loop_folder(session, name).iterdir()}
    page = (session / "report.html").read_text()
    assert 'href="loops/slow-one/report.html"' in page
    summary = json.loads((session / "summary.json").read_text())
    assert [one["loop"] for one in summary["loops"]] == [SLOW, FAST]


def test_every_loop_is_replayed_byte_for_byte(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(session), "--json"]) == 0
    loops = json.loads(capsys.readouterr().out)["loops"]
    assert [(one["loop"], one["identical"], one["compared"]) for one in loops] == [(SLOW, True, 2), (FAST, True, 1)]
    assert [one["samples"] for one in loops] == [body["samples"] for body in (over(session, SLOW), over(session, FAST))]
    assert main(["replay", str(session), "--loop", FAST]) == 0
    assert capsys.readouterr().out.count("identical") == 1


def over(session: Path, loop: str) -> dict[str, Any]:
    (body,) = bodies(session, "over", loop)
    return body


def test_a_question_about_one_of_several_loops_names_it(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["report", str(session), "--decision", "1"]) == 2
    assert capsys.readouterr().err == "--loop: there are 2 loops, name one of slow one, fast\n"
    assert main(["report", str(session), "--decision", "1", "--loop", "fats"]) == 2
    assert "there is no such loop; there are slow one, fast" in capsys.readouterr().err
    assert main(["report", str(session), "--decision", "1", "--loop", FAST]) == 0
    assert (loop_folder(session, FAST) / "decision-1.html").is_file()
    assert main(["ledger", "revert", str(session), "--decision", "1"]) == 2
    assert main(["ledger", "show", str(session), "--decision", "1"]) == 2
    capsys.readouterr()
    assert main(["ledger", "show", str(session), "--loop", FAST, "--kind", "decision", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["loop"] for row in rows] == [FAST]


def test_a_proposal_is_approved_by_its_hash_whose_loop_it_is_of(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["approve", str(session), "--json"]) == 0
    slow, fast = json.loads(capsys.readouterr().out)["loops"]
    assert slow["proposals"] == []
    (proposal,) = fast["proposals"]
    assert main(["approve", str(session), proposal["hash"][:8], "--by", "Ada"]) == 0
    (order,) = (loop_folder(session, FAST) / "orders").glob("*.json")
    assert json.loads(order.read_text())["digest"] == proposal["hash"]
    order.unlink()
    order.parent.rmdir()


def test_the_report_is_made_again_with_its_index(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in session.glob("**/report.html"):
        path.unlink()
    capsys.readouterr()
    assert main(["report", str(session), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["loops"]) == 2
    assert len(list(session.glob("**/report.html"))) == 3


def test_the_second_run_moves_the_first_aside_whole(tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(TEXT.replace("900.0", "60.0"))
    for _ in range(2):
        assert main(["run", str(tmp_path / "two.toml"), "--no-compare", "--out", str(tmp_path / "run")]) == 0
    assert len(read_loops(tmp_path / "run-1")[0]) == 2
    assert (tmp_path / "run-1" / "loops" / "fast" / "trend.csv").is_file()


@pytest.mark.parametrize(
    ("change", "line", "told"),
    [
        (("node = 2", "node = 1"), 48, 'loop[2].bus.node = 1 is the number of "slow one" on the same bus; each'),
        (('name = "fast"', 'name = "Slow-One"'), 38, 'loop[2].name = "Slow-One" names the files of "slow one", too;'),
        (("node = 2", 'node = 2\ninterface = "udp_multicast"'), 49, 'loop[2].bus.interface = "udp_multicast" and'),
        (("k = 2.0", "k = 0.0"), 51, "loop[2].device.plant.k = 0: the output would not move this plant"),
        (("kc = 0.6", "kc = 0.6\nkx = 1.0"), 10, "schedule.region[1].kx is not a known key"),
        (('pv_unit = "bar"', 'pv_unit = "bar"\nb = 7.0'), 40, "loop[2].b = 7.0 must be at most 1"),
        (("[schedule]\n", "[schedules]\n"), 4, "schedules is not a known key; did you mean schedule?"),
    ],
)
def test_what_is_wrong_is_told_once_with_its_line(change: tuple[str, str], line: int, told: str) -> None:
    with pytest.raises(UnusableError) as unusable:
        parse_session(TEXT.replace(*change))
    findings = [one for one in unusable.value.findings if told in one.text("two.toml")]
    assert len(findings) == 1
    assert findings[0].line == line


FOREIGN = """
[[loop]]
name = "axis {0}"
pv_unit = "rev/s"
pv_min = -50.0
pv_max = 50.0
co_min_pct = -100.0
sample_time_s = 0.05
[[loop.schedule.region]]
name = "all"
kc = 8.0
tau_i_s = 0.25
[loop.device]
kind = "dbc"
profile = "odrive"
node = {0}
co = {{ scale = 5.0 }}
gains = {{ scale = 50.0 }}
"""


def test_the_number_of_a_foreign_controller_is_that_of_its_device() -> None:
    head = 'schema = 1\n[schedule]\nvariable = "sp"\n[bus]\ninterface = "socketcan"\nchannel = "can0"\n'
    two = parse_session(head + FOREIGN.format(0) + FOREIGN.format(3))
    assert [config.node for config in two.loops] == [0, 3]
    assert any(line.endswith("channel can0, node 3") for line in described(two.loops[1], (), several=True))
    same = FOREIGN.format(3).replace("axis 3", "axis 4") + "[loop.bus]\nnode = 9\n"
    with pytest.raises(UnusableError) as unusable:
        parse_session(head + FOREIGN.format(3) + same)
    told = unusable.value.findings[0].text("two.toml")
    assert 'loop[2].device.node = 3 is the number of "axis 3" on the same bus' in told


def test_one_loop_written_as_a_table_of_several_names_itself_as_well() -> None:
    head = TEXT[: TEXT.index('[[loop]]\nname = "fast"')]
    assert parse_session(head).several
    assert parse_session(head).names == (SLOW,)
    assert not parse_session(head.replace("[[loop]]", "[loop]")).several


@pytest.mark.parametrize("mode", ["off", "trial"])
def test_what_the_command_line_changes_is_changed_for_every_loop(mode: str) -> None:
    given = parse_session(TEXT)
    loops = tuple(
        one.model_copy(update={"adaptation": one.adaptation.model_copy(update={"mode": mode})}) for one in given.loops
    )
    text = text_as_run(TEXT, SessionConfig(loops, several=True), {("adaptation", "mode"): mode})
    assert [one.adaptation.mode for one in parse_session(text).loops] == [mode, mode]
    assert text.count("by the command line") == 2
