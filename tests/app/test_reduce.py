"""retuner reduce: what it prints, and what it refuses in one line."""

import pytest
from command_line import answer, printed, refused

E2 = ["--num-t", "-0.3,0.08", "--den-t", "2,1,0.4,0.2,0.05,0.05,0.05"]


def test_json_is_one_document_with_the_model() -> None:
    model = answer("reduce", *E2, "--order", "2", "--k", "3")["model"]
    assert model["type"] == "sopdt"
    assert [model[x] for x in ("k", "tau1", "tau2", "theta")] == pytest.approx([3.0, 2.0, 1.2, 0.77])


def test_options_may_be_repeated_or_listed() -> None:
    given = (["--den-t", "5", "--den-t", "3", "--den-t", "0.5"], ["--den-t", "5 3 0.5"], ["--den-t", "0.5,3,5"])
    outputs = [answer("reduce", "--num-t", "-0.1", *den)["model"] for den in given]
    assert outputs[0] == outputs[1] == outputs[2]
    assert outputs[0]["theta"] == pytest.approx(2.1)


def test_text_shows_every_step() -> None:
    out = printed("reduce", "--num-t", "15", "--den-t", "20,1,.1,.1", "--k", "2")
    assert "T2: lead 15 s against lag 20 s" in out
    assert "0.15 s" in out


def test_integrating_type_names_the_unit_of_its_gain() -> None:
    out = printed("reduce", "--den-t", "1,1", "--integrators", "1")
    assert "integrating" in out
    assert "1 /s" in out
    assert "tau1" not in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--den-t", "1,x"], "--den-t x"),
        (["--den-t", "nan"], "--den-t nan"),
        (["--den-t", "-1"], "--den-t -1"),
        (["--den-t", "0"], "--den-t 0"),
        (["--den-t", "1", "--delay", "-1"], "theta_s = -1"),
        (["--den-t", "1", "--delay", "inf"], "theta_s = inf"),
        (["--den-t", "1", "--k", "0"], "k = 0"),
        (["--den-t", "1", "--order", "3"], "order = 3"),
        (["--den-t", "1", "--integrators", "2"], "order 2"),
        (["--den-t", "1", "--integrators", "-1"], "--integrators -1"),
        (["--den-t", "1", "--num-t", "2,3"], "more zeros than poles"),
        (["--den-t", "1", "--leads", "some"], "--leads some"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments, words):
    assert words in refused("reduce", *arguments)
