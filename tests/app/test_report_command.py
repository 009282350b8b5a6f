"""retuner report: the report and the page of a decision again from a session's folder, and what is told when not."""

import json
import shutil
from pathlib import Path

import pytest
from command_line import answer, refused
from recorded import SHORT, bodies, rewritten

from retuner.cli import main
from retuner.decision_page.row_values import number, part


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session with a few decisions."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "short.toml").write_text(SHORT)
    out = folder / "session"
    assert main(["run", str(folder / "short.toml"), "--mode", "auto", "--no-compare", "--out", str(out)]) == 0
    return out


def first_with_verdict(session: Path) -> dict[str, object]:
    return next(body for body in bodies(session, "decision") if body["verdict"])


@pytest.mark.slow
@pytest.mark.uncounted
def test_the_report_is_made_again_with_the_same_decisions(session: Path, tmp_path: Path) -> None:
    told = answer("report", session, "--out", tmp_path / "again.html")
    assert told["decisions"] == len(bodies(session, "decision"))
    again, once = ((folder / name).read_text() for folder, name in ((tmp_path, "again.html"), (session, "report.html")))

    def table(text: str) -> str:
        return text[text.index("<h2>Decisions</h2>") : text.index("<h2>Provenance</h2>")]

    assert table(again) == table(once)


@pytest.mark.slow
def test_a_page_tells_the_decision_and_where_the_ledger_has_it(session: Path, tmp_path: Path) -> None:
    body = first_with_verdict(session)
    path = tmp_path / "page.html"
    assert main(["report", str(session), "--decision", str(body["number"]), "--out", str(path)]) == 0
    text = path.read_text()
    ms = number(part(part(body, "verdict"), "ms"), "before")
    assert f"Ms {ms:.2f} before" in text
    assert "<th>ledger row</th>" in text
    assert "pv as the model has it" in text
    assert "src=" not in text  # nothing is loaded from elsewhere


@pytest.mark.slow
def test_without_a_trend_the_samples_come_from_the_bus_log(session: Path, tmp_path: Path) -> None:
    copy = tmp_path / "killed"
    shutil.copytree(session, copy)
    for name in ("trend.csv", "gains.toml", "summary.json"):
        (copy / name).unlink()
    decision = str(first_with_verdict(session)["number"])
    pages = []
    for folder in (session, copy):
        assert main(["report", str(folder), "--decision", decision, "--out", str(tmp_path / "p.html")]) == 0
        pages.append((tmp_path / "p.html").read_text())
    assert pages[0] == pages[1]
    assert main(["report", str(copy), "--out", str(tmp_path / "r.html")]) == 0


def cut(trend: Path) -> None:
    """End a trend in the middle of its ninth line."""
    lines = trend.read_text().splitlines()
    trend.write_text("\n".join([*lines[:8], ",".join(lines[8].split(",")[:2])]))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (
            lambda folder: (folder / "trend.csv").write_text("a,b\n1,2\n"),
            "trend.csv: line 1: is not the head of a trend",
        ),
        (lambda folder: cut(folder / "trend.csv"), "trend.csv:9: is damaged, 2 of "),
        (lambda folder: (folder / "summary.json").write_text("{"), "summary.json: is no JSON"),
        (lambda folder: (folder / "gains.toml").write_text("schema = 9\n"), "gains.toml: "),
        (lambda folder: (folder / "config.toml").write_text(SHORT + "# more\n"), "was changed after the run"),
        (
            lambda folder: [(folder / name).unlink() for name in ("trend.csv", "bus.blf")],
            "has no trend, and its bus log",
        ),
    ],
)
def test_a_damaged_session_is_told_in_one_line(session: Path, tmp_path: Path, damage, said: str, capsys) -> None:
    copy = tmp_path / "damaged"
    shutil.copytree(session, copy)
    damage(copy)
    capsys.readouterr()
    assert main(["report", str(copy)]) == 2
    told = capsys.readouterr()
    assert said in told.err
    assert told.err.count("\n") == 1
    assert told.out == ""


@pytest.mark.slow
@pytest.mark.uncounted
@pytest.mark.parametrize(
    ("out", "said"),
    [("none/r.html", "none does not exist; make it first"), (".", "is a folder; give the name of a file")],
)
def test_where_a_report_cannot_be_written_is_told_by_its_own_name(session, tmp_path, out, said):
    told = refused("report", session, "--out", str(tmp_path / out))
    assert told.startswith(f"{tmp_path / out}: ")
    assert said in told
    assert not list(tmp_path.iterdir())


def test_a_decision_that_is_not_there_is_named(session: Path) -> None:
    assert "has no decision 999; it has 1 to" in refused("report", session, "--decision", "999")


@pytest.mark.slow
def test_odd_bodies_in_a_ledger_do_no_harm(session: Path, tmp_path: Path) -> None:
    def odd(row):
        body = json.loads(row.text)
        return (
            {**body, "region": "<i>", "reason": None, "verdict": 7, "t_s": "soon"} if row.kind == "decision" else body
        )

    forged = rewritten(session, tmp_path / "forged", odd)
    assert main(["report", str(forged), "--out", str(tmp_path / "r.html")]) == 0
    assert "<i>" not in (tmp_path / "r.html").read_text()
