"""What a bump would teach: where loads never rest, single responses are not enough however many agree."""

from dataclasses import replace

import pytest
from loop_bench import GOOD, made

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.nudge.planner import NudgeInput, NudgeNews
from retuner.adaptive.nudge.settings import NudgeSettings
from retuner.adaptive.nudge.watching import Nudger
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.region_model.sequences import unsure

SOON = NudgeSettings(allowed=True, percent=5.0, after_h=0.1, announce_s=0.0)


def news(load: float) -> list[NudgeNews]:
    """Of a loop whose process two setpoint steps have shown, under loads of that size to both sides."""
    bench = made(GOOD)
    bench.run(400)
    bench.run(400, 1.0)
    bench.run(400, 0.0)
    known = bench.retuner.region_models[0]
    assert known.identifiable
    assert known.records > 1
    nudger, found = Nudger(SOON, bench.retuner), []
    for i in range(40):
        for sample in bench.samples(20, 0.0, load if i % 2 else -load, 10.0):
            bench.retuner.observe(sample)
            bench.retuner.region_models[0] = known
            bench.retuner.excitation[0] = replace(Excitation(), setpoints=2)
            found.append(nudger.look(sample))
    return [one for one in found if one is not None]


def test_a_loop_that_rests_and_is_known_from_two_records_needs_no_bump() -> None:
    assert news(0.0) == []


@pytest.mark.uncounted
def test_where_loads_never_rest_what_single_responses_say_is_not_enough() -> None:
    first = news(1.0)[0]
    assert first.cause is NudgeInput.DUE
    assert 'the model of region "a" rests on single responses' in first.reason


def test_bumps_go_on_until_they_have_told_the_settings_well() -> None:
    """Not a count of them decides, but how far apart the settings are that the models still ask for."""
    rough = Plausible(ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0), 0.0)
    steep = Plausible(ProcessModel(ProcessType.FOPDT, 1.6, 50.0, 0.0, 5.0), 2.0)
    bench = made(GOOD)
    bench.run(400)
    bench.run(400, 1.0)
    known = replace(bench.retuner.region_models[0], records=6)
    assert unsure(replace(known, plausible=(rough, rough)), 1.0) == ""
    assert "known within a factor of" in unsure(replace(known, plausible=(rough, steep)), 1.0)
