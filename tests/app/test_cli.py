"""The command line: exit statuses, one line per problem, JSON alone on stdout, never a traceback."""

import io
import json
import logging
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import run
from rich.console import Console
from typer.main import get_command

from retuner import cli, verbosity
from retuner.config import loading
from retuner.drivers.device import BusError
from retuner.drivers.recorded.recording import RecordingError
from retuner.errors import UserError, user_input
from retuner.live_view.live_screen import LiveScreen
from retuner.verbosity import LOGGER, be_normal, busy, quiet

HEAVY = ("numpy", "scipy", "filterpy", "matplotlib", "can", "cantools", "pydantic", "pyarrow", "asyncio")


def all_commands() -> list[str]:
    commands = getattr(get_command(cli.app), "commands")  # noqa: B009  typer types it as a plain command
    return sorted(commands)


def test_the_commands_are_there() -> None:
    assert {"init", "check"} <= set(all_commands())


@pytest.mark.parametrize("command", all_commands())
def test_every_help_has_an_example_of_its_own_command(command: str) -> None:
    shown = run(command, "--help")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert f"retuner {command}" in shown.stdout.partition("Example: ")[2]


def test_help_and_version_load_nothing_heavy() -> None:
    for argument in ("--help", "--version"):
        script = f"""if True:
            import sys
            from retuner.cli import main
            assert main([{argument!r}]) == 0
            print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"""
        done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=True)
        assert done.stderr.strip() == "[]"
    assert done.stdout.startswith("retuner ")


@pytest.mark.slow
def test_help_of_no_command_loads_a_bus_or_numbers() -> None:
    names = sorted(cli.COMMANDS)
    script = f"""if True:
        import sys
        from retuner.cli import main
        assert [main([name, "--help"]) for name in {names!r}] == [0] * {len(names)}
        print(sorted({set(HEAVY) - {"pydantic"}!r} & set(sys.modules)), file=sys.stderr)  # typer has pydantic"""
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=True)
    assert (done.stderr.strip(), len(names) > 10) == ("[]", True)


@pytest.mark.slow
def test_identify_loads_only_what_it_works_with(tmp_path: Path) -> None:
    rows = [f"{i * 0.1:.1f},0,{pv:.3f},{i >= 100:d}" for i, pv in enumerate(0.1 * max(0, i - 120) for i in range(300))]
    (tmp_path / "a.csv").write_text("t,sp,pv,co\n" + "\n".join(rows) + "\n")
    script = f"""if True:
        import sys
        from retuner import Retuner, identify
        from retuner.cli import main
        main(["identify", {str(tmp_path / "a.csv")!r}, "--open-loop"])
        print(sorted({set(HEAVY) - {"numpy", "pydantic"}!r} & set(sys.modules)), file=sys.stderr)"""
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    assert "integrating" in done.stdout


def test_init_then_check_then_init_again(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    assert (run("init", file).returncode, run("check", file).returncode) == (0, 0)
    file.write_text("mine")
    refused = run("init", file)
    assert (refused.returncode, refused.stderr) == (2, f"{file}: exists; give another name, or --force to replace it\n")
    assert file.read_text() == "mine"
    assert run("init", file, "--force").returncode == 0
    assert run("check", file).stdout.startswith(f"{file}: ok\n")
    assert [path.name for path in tmp_path.iterdir()] == ["a.toml"]


def test_init_refuses_places_that_cannot_be_written(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "none" / "a.toml", Path("/proc/a.toml")):
        done = run("init", place)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert str(place) in done.stderr


def test_init_keeps_a_link_and_the_permissions_of_the_umask(tmp_path: Path) -> None:
    (tmp_path / "real.toml").write_text("old")
    (tmp_path / "link.toml").symlink_to("real.toml")
    assert run("init", tmp_path / "link.toml", "--force").returncode == 0
    assert (tmp_path / "link.toml").is_symlink()
    assert (tmp_path / "real.toml").read_text().startswith("# retuner")
    umask = os.umask(0)
    os.umask(umask)
    assert (tmp_path / "real.toml").stat().st_mode & 0o777 == 0o666 & ~umask


def test_check_as_json_has_settings_and_gains(tmp_path: Path) -> None:
    run("init", tmp_path / "a.toml")
    done = run("check", tmp_path / "a.toml", "--json")
    answer = json.loads(done.stdout)
    assert (done.returncode, done.stderr, answer["ok"], answer["problems"]) == (0, "", True, [])
    assert answer["regions"][1]["gains"] == {"kc": 2.2, "tau_i": 150.0, "tau_d": 0.0}
    assert answer["regions"][1]["parallel"] == {"kp": 2.2, "ki": 2.2 / 150.0, "kd": 0.0}
    assert (answer["regions"][0]["low"], answer["regions"][-1]["high"]) == (0.0, 250.0)


def test_check_of_a_broken_file(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text("schema = 1\n[loop]\npv_min = nan\n")
    plain, as_json = run("check", file), run("check", file, "--json")
    assert (plain.returncode, plain.stdout, as_json.returncode, as_json.stderr) == (2, "", 2, "")
    problems = json.loads(as_json.stdout)["problems"]
    assert plain.stderr.splitlines() == [f"{file}:{p['line']} {p['key']} {p['message']}" for p in problems]
    assert {"line": 3, "key": "loop.pv_min"}.items() <= problems[-1].items()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["chek"], "No such command 'chek'"),
        (["check"], "Missing argument 'CONFIG'"),
        (["check", "--jsn", "x"], "No such option:? '?--jsn"),  # click 8.5 quotes it, typer's own does not
        (["check", "a", "b"], "unexpected extra argument"),
        (
            ["tune", "--k", "x"],
            "'--k': 'x'(; give a number| is not a valid float). `retuner tune --help`",
        ),  # old typers: click's
        (["check", "nowhere.toml"], "nowhere.toml: no such file"),
        (["check", "a\nb\x1b[31m"], r"a\\nb\\x1b\[31m: no such file"),
    ],
)
def test_wrong_use_is_one_line_and_status_2(arguments: list[str], told: str) -> None:
    done = run(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.search(told, done.stderr)
    assert done.stderr.count("\n") == 1
    assert done.stderr[:-1].isprintable()


def test_an_empty_folder_of_records_is_named(tmp_path: Path) -> None:
    done = run("diagnose", str(tmp_path))
    assert (done.returncode, done.stderr.partition("; ")[0]) == (2, f"{tmp_path}: no file in the folder")


def failing(error: BaseException) -> object:
    def work(*_: object, **__: object) -> int:
        raise error

    return work


@pytest.mark.parametrize(
    ("error", "status", "told"),
    [
        (KeyboardInterrupt(), 130, "retuner: interrupted\n"),
        (PermissionError(13, "Permission denied", "some/file"), 2, "some/file: Permission denied\n"),
        (OSError("odd"), 2, "retuner: odd\n"),
        (UserError("one", "two\n"), 2, "one\ntwo\\n\n"),
        (BusError("no such bus"), 2, "no such bus\n"),
        (RecordingError("a.csv:3: text"), 2, "a.csv:3: text\n"),
    ],
)
def test_errors_on_the_way_become_a_line_and_a_status(monkeypatch, error, status, told):
    monkeypatch.setattr(loading, "read_text", failing(error))
    assert run("check", "x") == (status, "", told)


@pytest.mark.slow
@pytest.mark.parametrize(("environment", "status", "lines"), [({}, 70, 1), ({"RETUNER_TRACEBACK": "1"}, 1, 9)])
def test_a_defect_of_ours_is_one_line_unless_asked_for(environment: dict[str, str], status: int, lines: int) -> None:
    script = """if True:
        import sys
        from retuner.cli import main
        import retuner.config.loading as module
        module.read_text = lambda *_, **__: 1 / 0
        sys.exit(main(["check", "x"]))"""
    env = {k: v for k, v in os.environ.items() if k != "RETUNER_TRACEBACK"} | environment
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=False, env=env)
    assert done.returncode == status
    assert "ZeroDivisionError: division by zero" in done.stderr
    assert ("Traceback" in done.stderr) == bool(environment)
    assert done.stderr.count("\n") >= lines


def test_a_value_error_of_the_pure_rooms_is_told_with_its_place() -> None:
    with pytest.raises(UserError, match=r"^--tau1: must be positive$"), user_input("--tau1"):
        raise ValueError("must be positive")


def test_a_file_that_cannot_be_written_whole_leaves_the_old_one(tmp_path, monkeypatch):
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "a.toml").write_text("old")
    monkeypatch.setattr(os, "fsync", full)
    done = run("init", tmp_path / "a.toml", "--force")
    assert done == (2, "", f"{tmp_path / 'a.toml'}: cannot be written: No space left on device\n")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.toml", "old")]


def test_without_arguments_the_help_is_shown() -> None:
    done = run()
    assert (done.returncode, done.stderr) == (2, "")
    assert "Usage: retuner" in done.stdout


# -q, -v and -vv are the same in every command; what is answered stands on standard output whatever was chosen.


TUNE = ["tune", "--type", "fopdt", "--k", "1", "--tau1", "10", "--theta", "2"]


@pytest.fixture(autouse=True)
def as_it_was() -> Iterator[None]:
    yield
    be_normal()


class Terminal(io.StringIO):
    """A stream that says it is a screen."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("command", ["run", "identify", "ledger show", "experiment step", "tune", "doctor"])
def test_every_command_has_them(command: str) -> None:
    shown = run(*command.split(), "--help").stdout

    assert "--quiet" in shown
    assert "--verbose" in shown
    assert shown.count("-v,") == 1


def test_quiet_may_stand_before_the_command_and_after_it() -> None:
    before = run("-q", *TUNE)
    after = run(*TUNE, "-q")

    assert (before.returncode, before.stdout) == (after.returncode, after.stdout)
    assert before.stdout == run(*TUNE).stdout


def test_a_command_begins_as_if_none_had_been_before_it() -> None:
    run("-q", *TUNE)
    assert quiet()
    run("-vv", *TUNE)
    assert not quiet()
    run(*TUNE)

    handlers = (*LOGGER.handlers, *logging.getLogger().handlers)
    assert not [one for one in handlers if isinstance(one, verbosity._ErrorStream)]


def test_verbose_tells_on_the_error_stream_and_answers_the_same() -> None:
    plain, told = run(*TUNE), run(*TUNE, "-v")

    assert told.stdout == plain.stdout
    assert plain.stderr == ""
    assert "retuner: tune" in told.stderr
    assert "s of CPU" in told.stderr


def test_work_that_takes_long_is_shown_on_a_terminal_and_wiped(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(verbosity, "FIRST_S", 0.0)
    monkeypatch.setattr(verbosity, "EVERY_S", 0.001)

    with busy("reading a.csv"):
        while screen.getvalue().count("reading a.csv") < 3:
            pass

    assert "reading a.csv ... 0 s" in screen.getvalue()
    assert screen.getvalue().endswith("\r" + " " * len("reading a.csv ... 0 s") + "\r")


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()])
def test_nothing_is_shown_to_a_file_or_when_quiet(stream: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(verbosity, "FIRST_S", 0.0)
    verbosity._hush(stream.isatty())

    with busy("reading a.csv"):
        pass

    assert stream.getvalue() == ""


def test_quick_work_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)

    with busy("reading a.csv"):
        pass

    assert screen.getvalue() == ""


def test_a_quiet_run_says_what_it_leaves_and_nothing_of_its_course() -> None:
    screen = Terminal()
    live = LiveScreen(Console(file=screen, force_terminal=True), answers_only=True)

    with live:
        live.begin("oven")
        live.event("the CAN link is down")
        live.say("report: runs/report.html")

    assert not live.live
    assert screen.getvalue() == "report: runs/report.html\n"
