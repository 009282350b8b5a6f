"""A session with a change that the other loop does not survive: half of it, or none, is made again by a replay."""

import json

import pytest
from command_line import printed

from retuner.adaptive.guard.step_size import change_factor
from retuner.cli import main
from retuner.ledger import LedgerReader
from retuner.one_plant.change_among_loops import Among
from retuner.schedule.gains import PidGains

REFUSED = "refused: with two on the same plant: Ms of two 3.00, now 1.50; limit 1.75"
PAIR = """
schema = 1
schedule = { variable = "sp" }
adaptation = { mode = "auto" }
bus = { interface = "virtual", channel = "pair" }
output = { directory = "out" }
[device.plant]
kind = "state_space"
shared = "pair"
a = [[-0.1, 0.0], [0.0, -0.1]]
b = [[0.1, 0.0], [0.0, 0.1]]
c = [[1.0, 0.0], [0.0, 1.0]]
theta_s = 2.0
inputs = ["u1", "u2"]
outputs = ["y1", "y2"]
start_pv = 20.0
noise = 0.02
"""
LOOP = """
[[loop]]
name = "{name}"
pv_unit = "cm"
pv_min = 0.0
pv_max = 100.0
sample_time_s = 0.5
bus = {{ node = {node} }}
device = {{ plant = {{ input = "u{node}", output = "y{node}" }} }}
schedule = {{ region = [{{ name = "all", kc = 0.8, tau_i_s = 10.0 }}] }}
scenario = {{ duration_s = 120.0, steps = [{steps}] }}
"""


@pytest.mark.uncounted
@pytest.mark.parametrize(
    ("most", "code"),
    [(1.7, "accepted"), pytest.param(1.05, "not_survived", marks=[pytest.mark.slow, pytest.mark.uncounted])],
)
def test_a_session_with_a_refused_change_is_decided_again_byte_for_byte(tmp_path, monkeypatch, most, code):
    before = PidGains.from_ideal(0.8, 10.0)
    monkeypatch.setattr(
        Among, "_against", lambda _, gains, _basis: REFUSED if change_factor(before, gains) > most else ""
    )
    monkeypatch.chdir(tmp_path)
    rest, step = "{ at_s = 0.0, sp = 20.0 }", "{ at_s = 5.0, sp = 25.0 }"
    text = PAIR + LOOP.format(name="one", node=1, steps=f"{rest}, {step}") + LOOP.format(name="two", node=2, steps=rest)
    (tmp_path / "pair.toml").write_text(text, encoding="utf-8")
    assert main(["run", "pair.toml", "--no-compare"]) == 0
    with LedgerReader(tmp_path / "out" / "ledger.sqlite") as reader:
        rows = [(row.kind, json.loads(row.text)) for row in reader.rows()]
    made = next(body for kind, body in rows if kind == "decision")
    assert made["code"] == code
    assert REFUSED in made["reason"]
    assert "identical" in printed("replay", "out")
