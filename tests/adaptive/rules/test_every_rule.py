"""What every rule must do: scale as dimensions demand, mirror, refuse what it has no answer for."""

import math
import runpy
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from effort import examples, sized
from hypothesis import given, settings
from hypothesis import strategies as st
from templates import template

from retuner import ProcessModel, ProcessType, tune
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.optimum import optimal_pi, references
from retuner.adaptive.loop.performance import performance, weighted_cost
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.registry import RULES
from retuner.adaptive.rules.registry import settings as rule_settings
from retuner.adaptive.rules.rule import ControllerKind, Rule, Takes, Tuning, Wishes
from retuner.adaptive.rules.simc import derivative_pays, simc
from retuner.schedule.gains import PidGains, from_form

T = ProcessType
PAIRS = [(rule, kind) for rule in (*RULES.values(), *template("rule").RULES) for kind in rule.kinds]
FROM_MODEL = [(r, k) for r, k in PAIRS if r.takes == Takes.MODEL and r.name != "optimal"]
FROM_READING = [(r, k) for r, k in PAIRS if r.takes != Takes.MODEL]


def ids(pairs: list[tuple[Rule, ControllerKind]]) -> list[str]:
    return [f"{rule.name} {kind}" for rule, kind in pairs]


def models(types: tuple[ProcessType, ...]) -> st.SearchStrategy[ProcessModel]:
    def build(type_: ProcessType, k: float, tau1: float, share: float, theta: float) -> ProcessModel:
        lag1 = tau1 if type_ in (T.FOPDT, T.SOPDT, T.SOPDT_INVERSE, T.SOPDT_LEAD, T.TOPDT) else 0.0
        lag2 = tau1 * share if type_ in (T.SOPDT, T.INTEGRATING_LAG, T.SOPDT_INVERSE, T.SOPDT_LEAD, T.TOPDT) else 0.0
        zero, third = (theta * share if type_ == own else 0.0 for own in (T.SOPDT_INVERSE, T.TOPDT))
        zero -= tau1 / 3 if type_ == T.SOPDT_LEAD else 0.0
        return ProcessModel(type_, k, lag1, lag2, theta, inverse_s=zero, tau3_s=third)

    return st.builds(
        build, st.sampled_from(types), st.floats(0.01, 100), st.floats(1, 50), st.floats(0.05, 1), st.floats(0.5, 20)
    )


def scaled(model: ProcessModel, a: float, g: float) -> ProcessModel:
    per_second = {T.INTEGRATING: 1, T.INTEGRATING_LAG: 1, T.DOUBLE_INTEGRATING: 2}.get(model.type, 0)
    times = (model.tau1_s * a, model.tau2_s * a, model.theta_s * a)
    return ProcessModel(
        model.type, model.k * g / a**per_second, *times, inverse_s=model.inverse_s * a, tau3_s=model.tau3_s * a
    )


def answer(rule: Rule, kind: ControllerKind, model: ProcessModel, a: float = 1.0, g: float = 1.0) -> PidGains | str:
    """The rule's gains, or that it refuses; wishes, where the rule needs some, scale along."""
    wishes = Wishes(u0=0.2 / g, y_max=1.0) if rule.name == "simc-smooth" else Wishes()
    try:
        return rule_settings(rule, kind, scaled(model, a, g), None, wishes).gains
    except ValueError:
        return "refused"


def assert_equal(found: PidGains, expected: PidGains, rel: float) -> None:
    for name in ("kp", "ki", "kd"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=rel, abs=1e-300)


@pytest.mark.parametrize(("rule", "kind"), FROM_MODEL, ids=ids(FROM_MODEL))
@settings(max_examples=examples(25))
@given(data=st.data(), a=st.floats(1e-3, 1e3), g=st.floats(1e-3, 1e3), action=st.sampled_from([1.0, -1.0]))
def test_time_and_gain_scale_as_dimensions_demand_and_reverse_action_mirrors(rule, kind, data, a, g, action):
    g *= action
    model = data.draw(models(rule.types))
    base, other = answer(rule, kind, model), answer(rule, kind, model, a, g)
    if isinstance(base, str) or isinstance(other, str):
        assert base == other
        return
    assert_equal(PidGains(other.kp * g, other.ki * g * a, other.kd * g / a), base, 1e-9)
    assert max(base.kp, base.ki) > 0


@pytest.mark.parametrize(("rule", "kind"), FROM_READING, ids=ids(FROM_READING))
@given(ku=st.floats(1e-3, 1e3), pu=st.floats(1e-3, 1e3), a=st.floats(1e-3, 1e3), g=st.floats(1e-3, 1e3))
def test_readings_scale_too(rule: Rule, kind: ControllerKind, ku: float, pu: float, a: float, g: float) -> None:
    names = ("ku", "pu") if rule.takes == Takes.ULTIMATE else ("kq", "pq")

    def at(gain: float, period: float) -> PidGains:
        return tune(None, rule.name, kind=kind, **dict(zip(names, (gain, period), strict=True))).tuning.gains

    base, other = at(ku, pu), at(ku / g, pu * a)
    assert_equal(PidGains(other.kp * g, other.ki * g * a, other.kd * g / a), base, 1e-9)
    mirrored = at(-ku, pu)
    assert (mirrored.kp, mirrored.ki, mirrored.kd) == (-base.kp, -base.ki, -base.kd)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pi", "pid"])
def test_optimal_scales_and_mirrors(kind: str) -> None:
    base = tune(ProcessModel(T.SOPDT, 1.0, 5.0, 1.0, 1.0), "optimal", kind=kind).tuning.gains
    other = tune(ProcessModel(T.SOPDT, -20.0, 500.0, 100.0, 100.0), "optimal", kind=kind).tuning.gains
    assert_equal(PidGains(other.kp * -20, other.ki * -20 * 100, other.kd * -20 / 100), base, 2e-3)


@pytest.mark.parametrize(("rule", "kind"), FROM_MODEL, ids=ids(FROM_MODEL))
@given(data=st.data())
@settings(max_examples=examples(15))
def test_forms_round_trip(rule: Rule, kind: ControllerKind, data: st.DataObject) -> None:
    model = data.draw(models(rule.types))
    gains = answer(rule, kind, model)
    if isinstance(gains, str) or gains.kp == 0:
        return
    for form in ("series", "ideal", "parallel"):
        if form == "series" and gains.ki and gains.kp**2 < 4 * gains.ki * gains.kd * (1 + 1e-9):
            continue  # complex zeros: no series form
        shown = Tuning(rule.name, rule.form, gains).to_dict(form)["gains"]
        assert_equal(from_form(form, shown["kc"], shown["tau_i"], shown["tau_d"]), gains, 1e-9)


@pytest.mark.parametrize("name", [name for name, rule in RULES.items() if rule.takes == Takes.MODEL])
def test_without_dead_time_a_rule_answers_or_says_what_to_give(name: str) -> None:
    wishes = {"u0": 0.5, "y_max": 1.0} if name == "simc-smooth" else {}
    if name in {"lambda", "imc", "imc-pi", "simc-smooth"}:
        assert tune(ProcessModel(T.FOPDT, 1.0, 5.0), name, **wishes).tuning.gains.kp > 0
        return
    if T.FOPDT not in RULES[name].types:
        with pytest.raises(ValueError, match="has no settings for type fopdt"):
            tune(ProcessModel(T.FOPDT, 1.0, 5.0), name)
        return
    with pytest.raises(ValueError, match="theta = 0"):
        tune(ProcessModel(T.FOPDT, 1.0, 5.0), name)


@pytest.mark.parametrize("name", list(RULES))
def test_every_rule_says_where_it_comes_from(name: str) -> None:
    rule = RULES[name]
    assert rule.source
    assert rule.valid
    assert rule.form in {"series", "ideal", "parallel"}
    assert all(lines and all(" = " in x or "minimise" in x for x in lines) for lines in rule.formulas.values())
    assert (rule.from_model is None) != (rule.from_oscillation is None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rule": "voodoo"}, "give one of simc"),
        ({"rule": "cohen-coon", "tau_c": 1.0}, "has no use for tau_c"),
        ({"rule": "amigo", "u0": 1.0}, "has no use for u0"),
        ({"rule": "simc", "ku": 1.0, "pu": 1.0}, "no use for ku"),
        ({"rule": "zn-ultimate", "ku": 1.0}, "give both ku and pu"),
        ({"rule": "zn-ultimate", "ku": 0.0, "pu": 1.0}, "ku = 0"),
        ({"rule": "zn-ultimate", "ku": 1.0, "pu": -1.0}, "pu = -1"),
        ({"rule": "quarter-decay"}, "kq and pq"),
        ({"rule": "simc", "tau_c": 1.0, "ms": 1.5}, "exclude each other"),
        ({"rule": "simc", "ms": 0.9}, "more than 1"),
        ({"rule": "simc", "gm": math.nan}, "gm = nan"),
        ({"rule": "simc", "c": 0.0}, "c = 0"),
        ({"rule": "simc", "tau_c": -1.0}, "negative"),
        ({"rule": "simc-smooth"}, "needs u0"),
        ({"rule": "simc-smooth", "u0": 9.0, "y_max": 0.1}, "cannot be held"),
        ({"rule": "zn-some-overshoot", "kind": "pi"}, "has no PI settings"),
        ({"rule": "simc", "kind": "p"}, "has no P settings"),
        ({"rule": "lambda", "tau_c": 0.0}, "lambda"),
        ({"rule": "optimal", "ms": 1.0}, "more than 1"),
    ],
)
def test_refusals_say_why(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tune(ProcessModel(T.FOPDT, 1.0, 10.0, 0.0, 2.0), **arguments)


@pytest.mark.parametrize(
    ("model", "rule", "message"),
    [
        (ProcessModel(T.DELAY, 1.0, theta_s=1.0), "cohen-coon", "type delay"),
        (ProcessModel(T.INTEGRATING, 1.0, theta_s=1.0), "itae-load", "type integrating"),
        (ProcessModel(T.DOUBLE_INTEGRATING, 1.0, theta_s=1.0), "amigo", "type double-integrating"),
        (ProcessModel(T.DOUBLE_INTEGRATING, 1.0, theta_s=1.0), "zn-ultimate", "ultimate gain"),
        (ProcessModel(T.FOPDT, 1.0, 5.0), "zn-ultimate", "no ultimate gain"),
        (ProcessModel(T.DELAY, 1.0, theta_s=1.0), "simc-smooth", "type delay"),
    ],
)
def test_a_rule_that_does_not_apply_says_so(model: ProcessModel, rule: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tune(model, rule)


def test_numbers_beyond_floats_are_refused_in_words() -> None:
    with pytest.raises(ValueError, match=r"not a finite|beyond|rounds to 0|all zero"):
        tune(ProcessModel(T.FOPDT, 1e-300, 1e300, 0.0, 1e-300), "cohen-coon")


def test_derivative_pays_only_when_the_second_lag_is_longer_than_the_dead_time() -> None:
    assert derivative_pays(ProcessModel(T.SOPDT, 1.0, 5.0, 2.0, 1.0))
    assert not derivative_pays(ProcessModel(T.SOPDT, 1.0, 5.0, 1.0, 2.0))
    advised = tune(ProcessModel(T.SOPDT, 1.0, 5.0, 2.0, 1.0)).to_dict()["notes"]
    assert "derivative action would pay" in str(advised)
    assert "hardly pays" in str(tune(ProcessModel(T.SOPDT, 1.0, 5.0, 1.0, 2.0), kind="pid").to_dict()["notes"])
    assert tune(ProcessModel(T.SOPDT, 1.0, 5.0, 1.0, 2.0)).to_dict()["notes"] == []


def test_the_page_of_rules_is_up_to_date() -> None:
    root = Path(__file__).parents[3]
    page = runpy.run_path(str(root / "scripts" / "document_rules.py"))["page"]()
    assert (root / "docs" / "rules.md").read_text() == page, "run: python scripts/document_rules.py"


# ---- SIMC over the test batch of Astrom & Hagglund: the distribution of Ms, and J against the best PI for some

sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))
BATCH = {member.name: member.process for member in import_module("online.rivals").batch()}


def test_ms_over_the_batch() -> None:
    # computed for this project on a dense grid: 1.39 to 1.98, median 1.59, above 1.8 for P6 with L <= 0.7 and all of P9
    peaks = {name: sensitivity_peak(p, simc(half_rule(p)).gains) for name, p in BATCH.items()}
    values = np.array(list(peaks.values()))
    assert len(values) == 134
    assert (round(values.min(), 2), round(values.max(), 2), round(float(np.median(values)), 2)) == (1.39, 1.98, 1.59)
    high = {name for name, value in peaks.items() if value > 1.8}
    assert high == {n for n in BATCH if n.startswith("P9") or (n.startswith("P6") and float(n[5:]) <= 0.7)}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["P1 T=0.02", "P2 T=2", "P4 n=4", "P6 L=0.5", "P8 a=1", "P9 T=0.5"][:: sized(2, 2, 1)])
def test_simc_is_near_the_best_pi_at_its_ms(name: str) -> None:
    # over the whole batch by the lines below: median 1.05, at most 1.33 on the nearly pure delay
    process = BATCH[name]
    gains = simc(half_rule(process)).gains
    best = references(process)
    j = weighted_cost(performance(process, gains), best.iae_setpoint, best.iae_load)
    ratio = j / optimal_pi(process, sensitivity_peak(process, gains)).cost
    assert 1 - 1e-6 < ratio < 1.335
    if name == "P1 T=0.02":
        assert ratio == pytest.approx(1.324, abs=0.006)
