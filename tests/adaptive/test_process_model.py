"""Process models: what of them a sampled controller sees."""

from dataclasses import replace

from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType


def test_a_sampled_controller_sees_half_an_interval_more_dead_time_and_else_the_same() -> None:
    swinging = ProcessModel(ProcessType.SOPDT, -2.0, 20.0, 20.0, 5.0, 0.4)
    assert swinging.seen_by_controller(3.0) == replace(swinging, theta_s=6.5)
    whole = LinearProcess(2.0, (50.0,), (-1.0,), 5.0, 1, ((8.0, 400.0),))
    assert whole.seen_by_controller(3.0) == replace(whole, theta_s=6.5)
    assert swinging.seen_by_controller(3.0).linear() == swinging.linear().seen_by_controller(3.0)
