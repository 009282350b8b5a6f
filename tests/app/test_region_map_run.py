"""A table along temperature and flow on the virtual device: no bumps, a stale flow holds, a log tells it all."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from command_line import answer, printed, refused
from effort import sized
from once import once

from retuner import LoopSample, Mode, TrialEvent
from retuner.cli import main
from retuner.commands.check import described
from retuner.config.bench_plants import known_plant
from retuner.config.loading import UnusableError, parse_config, parse_session, text_as_run
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.device import VariableChanged
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.recorded.frame_log import Overhearing, read_frames
from retuner.ledger import LedgerReader
from retuner.schedule.pid import step
from retuner.session.assembly import (
    device_settings,
    link_settings,
    make_retuner,
    schedule_inputs,
    virtual_device_settings,
)
from retuner.session.ledger_rows import abort_cause
from retuner.session.loop_session import LoopSession
from retuner.session.outputs import loop_folder, read_loops
from retuner.session.scenario import ScenarioPlayer

EXAMPLE = (Path(__file__).resolve().parents[2] / "examples" / "boiler_2d.toml").read_text()
SCENARIO = """[scenario]
duration_s = 1500.0
steps = [
    { at_s = 0.0, sp = 55.0 },
    { at_s = 200.0, sp = 75.0 },
    { at_s = 400.0, load = -60.0 },
    { at_s = 700.0, sp = 55.0 },
    { at_s = 1000.0, load = 0.0 },
    { at_s = 1100.0, sp = 75.0, load = -60.0 },
    { at_s = 1300.0, sp = 55.0, load = 0.0 },
]
[output]
"""
BUMP = 1e-9 * 100.0


def config(lookup: str = "hard", derivative: str = "", loop: str = "") -> Config:
    text = EXAMPLE[: EXAMPLE.index("# Each cell")] + SCENARIO
    text = text.replace('lookup = "hard"', f'lookup = "{lookup}"').replace("start_c = 40.0", "start_c = 55.0")
    text = text.replace("tau_i_s = ", f"{derivative}tau_i_s = ")
    return parse_config(text.replace("sample_time_s = 2.0", f"sample_time_s = 2.0\n{loop}"))


@dataclass
class Bench:
    """A session on a virtual device, sample by sample; what it recorded."""

    config: Config
    device: VirtualDevice
    session: LoopSession
    clock: SimulatedClock
    on_bus: DeviceOnBus
    rows: list[tuple[str, Mapping[str, object]]] = field(default_factory=list)

    def turn(self) -> None:
        """One sample."""
        self.clock.advance(self.config.loop.sample_time_s)
        self.on_bus.sample()
        self.session.poll(self.clock.now_s())

    def told(self, kind: str) -> list[Mapping[str, object]]:
        return [body for name, body in self.rows if name == kind]


@contextmanager
def bench(config: Config, channel: str, mode: Mode = Mode.OFF, log: Path | None = None) -> Iterator[Bench]:
    clock = SimulatedClock()
    settings = replace(link_settings(config), channel=channel)
    plant = known_plant(config)
    assert plant is not None
    device = VirtualDevice(virtual_device_settings(config), plant)
    rows: list[tuple[str, Mapping[str, object]]] = []
    with CanLink(settings, clock) as far, CanLink(settings, clock, log) as near:
        host = CanDevice(near, device_settings(config))
        session = LoopSession(
            host,
            make_retuner(config, mode),
            ScenarioPlayer(config.scenario),
            lambda kind, _, body: rows.append((kind, body)),
        )
        yield Bench(config, device, session, clock, DeviceOnBus(device, far), rows)


LAWS = (("", ""), ("tau_d_s = 3.0\n", "b = 0.6\nco_rate_pct_per_s = 0.5\n"), ("tau_d_s = 3.0\n", "tau_f_s = 1.0\n"))


@pytest.mark.slow
@pytest.mark.parametrize("lookup", ["hard", "interpolated"])
@pytest.mark.parametrize(("derivative", "loop"), LAWS[: sized(2, 2, 3)])
def test_no_crossing_bumps_on_the_device(lookup: str, derivative: str, loop: str) -> None:
    """At every swap of gains co is what the old law would have given at this sample, over both kinds of boundaries."""
    with bench(config(lookup, derivative, loop), f"map-{lookup}-{len(loop)}") as b:
        swaps, regions, bumps = 0, set(), []
        while not b.session.finished:
            law, state, running = b.device._law, b.device._state, b.device.running.seq
            b.turn()
            regions.add(b.session.retuner.region)
            if b.device.running.seq != running:
                swaps += 1
                _, expected = step(law, state, b.device.sp, b.device.pv, 2.0)
                bumps.append(abs(b.device.co - expected))
    assert regions >= {0, 1, 2, 3}
    assert swaps >= (6 if lookup == "hard" else 20)
    assert max(bumps) <= BUMP


@pytest.mark.uncounted
def test_gains_in_force_follow_temperature_and_flow() -> None:
    with bench(config("interpolated"), "map-follow") as b:
        table = b.session.table
        far = 0.0
        while not b.session.finished:
            b.turn()
            running = b.session.device.running
            if b.session.retuner.region is None or running is None or b.session.samples % 50 < 49:
                continue
            wanted = table.at(b.session.retuner.region, *b.session.retuner.scheduled)
            far = max(far, abs(running.gains.kp / wanted.kp - 1.0))
    assert far < 0.05, "a write at each 2 %, and the flow's noise"
    x2 = b.session.trend.columns()["x2"]
    assert np.percentile(x2, [5, 95]) == pytest.approx([40.0, 100.0], abs=2.0)


def test_a_stale_flow_keeps_the_region_holds_the_adaptation_and_is_told() -> None:
    """The meter falls silent while the loop crosses to little flow: nothing changes; then it is back."""
    with bench(config(), "map-stale", Mode.AUTO) as b:
        plant, send = b.device.plant, b.on_bus.link.send
        silent = False

        def some(message: can.Message) -> bool:
            return True if silent and message.is_extended_id else send(message)

        b.on_bus.link.send = some  # type: ignore[method-assign]  # the meter's frames are lost, the others are not
        while b.session.samples < 150:
            b.turn()
        before = b.session.retuner.region
        silent = True
        plant_flow = []
        while b.session.samples < 300:
            b.turn()
            plant_flow.append(plant.aux)
        assert min(plant_flow) < 45.0
        assert b.session.retuner.region == before
        assert np.isnan(b.session.trend.columns()["x2"][-1])
        assert b.told("variable")[-1]["known"] is False
        assert [d.code for d in b.session.decisions if d.t_s > 320.0] in ([], ["variable_unknown"])
        silent = False
        for _ in range(20):
            b.turn()
        assert b.told("variable")[-1]["known"] is True
        assert b.session.retuner.region != before


def test_before_the_flow_was_ever_heard_nothing_is_scheduled() -> None:
    with bench(config(), "map-never", Mode.AUTO) as b:
        send = b.on_bus.link.send
        b.on_bus.link.send = lambda message: message.is_extended_id or send(message)  # type: ignore[method-assign]
        for _ in range(40):
            b.turn()
        assert b.session.retuner.region is None
        assert b.told("intent") == []
        assert "never heard" in str(b.told("variable")[0]["reason"])


def test_a_change_on_trial_is_taken_back_when_a_variable_becomes_unknown() -> None:
    assert abort_cause(VariableChanged("PLANT.aux", known=False, reason="")) is TrialEvent.LOST_TELEMETRY
    assert abort_cause(VariableChanged("PLANT.aux", known=True, reason="")) is None


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
def test_the_log_of_the_bus_tells_the_same_samples(tmp_path: Path, suffix: str) -> None:
    log = tmp_path / f"bus{suffix}"
    seen: list[LoopSample] = []
    with bench(config(), f"map-log{suffix}", log=log) as b:
        b.session._on_sample = lambda _loop, sample: seen.append(sample)
        for _ in range(300):
            b.turn()
    heard = Overhearing(1, 2.0, schedule_inputs(b.config))
    again = [joined.sample for message in read_frames(log) if (joined := heard.take(message)) is not None]
    assert again == seen
    assert len({sample.x2 for sample in again}) > 100


# ---- Several loops in one session: each as if it were alone, one ledger, and everything names the loop

TEXT = (Path(__file__).parent / "several.toml").read_text(encoding="utf-8")
SLOW, FAST = "slow one", "fast"
IN_STEP = TEXT.replace("sample_time_s = 1.0", "sample_time_s = 2.0")
"""Both make their samples at the same moments, so the host looks at each as often as if it were alone."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both loops in one run."""

    def run(folder: Path) -> None:
        (folder / "two.toml").write_text(IN_STEP)
        assert main(["run", str(folder / "two.toml"), "--no-compare", "--out", str(folder / "run")]) == 0

    return once(tmp_path_factory, "several", run) / "run"


def bodies(session: Path, kind: str, loop: str) -> list[dict[str, Any]]:
    with LedgerReader(session / "ledger.sqlite") as ledger:
        return [row.body for row in ledger.rows() if row.kind == kind and row.body.get("loop") == loop]


@pytest.mark.slow
def test_each_loop_decides_what_it_decides_alone(session: Path, tmp_path: Path) -> None:
    found = parse_session(IN_STEP)
    for i, name in enumerate((SLOW, FAST)):
        alone = text_as_run(IN_STEP, SessionConfig((found.loops[i],)), {})
        (tmp_path / f"{i}.toml").write_text(alone)
        assert main(["run", str(tmp_path / f"{i}.toml"), "--no-compare", "--out", str(tmp_path / f"{i}")]) == 0
        decided = bodies(session, "decision", name)
        assert decided == bodies(tmp_path / f"{i}", "decision", name)
        assert [one["action"] for one in decided] == [["commit", "restore"], ["advise"]][i]


@pytest.mark.slow
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


@pytest.mark.slow
def test_every_loop_is_replayed_byte_for_byte(session: Path) -> None:
    loops = answer("replay", session)["loops"]
    assert [(one["loop"], one["identical"], one["compared"]) for one in loops] == [(SLOW, True, 2), (FAST, True, 1)]
    assert [one["samples"] for one in loops] == [body["samples"] for body in (over(session, SLOW), over(session, FAST))]
    assert printed("replay", session, "--loop", FAST).count("identical") == 1


def over(session: Path, loop: str) -> dict[str, Any]:
    (body,) = bodies(session, "over", loop)
    return body


def test_a_question_about_one_of_several_loops_names_it(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["report", str(session), "--decision", "1"]) == 2
    assert capsys.readouterr().err == "--loop: there are 2 loops, name one of slow one, fast\n"
    assert "there is no such loop; there are slow one, fast" in refused(
        "report", session, "--decision", "1", "--loop", "fats"
    )
    assert main(["report", str(session), "--decision", "1", "--loop", FAST]) == 0
    assert (loop_folder(session, FAST) / "decision-1.html").is_file()
    assert main(["ledger", "revert", str(session), "--decision", "1"]) == 2
    assert main(["ledger", "show", str(session), "--decision", "1"]) == 2
    capsys.readouterr()
    rows = answer("ledger", "show", session, "--loop", FAST, "--kind", "decision")["rows"]
    assert [row["loop"] for row in rows] == [FAST]


def test_a_proposal_is_approved_by_its_hash_whose_loop_it_is_of(session):
    slow, fast = answer("approve", session)["loops"]
    assert slow["proposals"] == []
    (proposal,) = fast["proposals"]
    assert main(["approve", str(session), proposal["hash"][:8], "--by", "Ada"]) == 0
    (order,) = (loop_folder(session, FAST) / "orders").glob("*.json")
    assert json.loads(order.read_text())["digest"] == proposal["hash"]
    order.unlink()
    order.parent.rmdir()


@pytest.mark.slow
def test_the_report_is_made_again_with_its_index(session: Path) -> None:
    for path in session.glob("**/report.html"):
        path.unlink()
    assert len(answer("report", session)["loops"]) == 2
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
