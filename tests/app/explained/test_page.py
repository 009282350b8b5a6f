"""A decision's page tells what the decision says: its numbers, no section without content, no text as markup."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import pytest
from decision_documents import (
    ADVISED,
    BORROWED,
    COMMIT,
    EVERY_KIND,
    MODEL,
    PATTERN,
    REFUSED,
    RESTORED,
    WORSE,
    changed,
    plain,
    view,
)
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.loop.margins import margins
from retuner.decision_page import robustness_drawing
from retuner.decision_page.decision_document import article, page
from retuner.decision_page.decision_sentences import footing, headline, ms_limit, robustness
from retuner.decision_page.decision_view import DecisionView, what_came_of, worth_pages
from retuner.decision_page.decision_words import one_line

VOID = {"meta", "img", "br"}


class Balance(HTMLParser):
    """Every element that is opened is closed, in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()

    def handle_starttag(self, tag: str, attrs: object) -> None:
        del attrs
        self.seen.add(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def elements(text: str) -> set[str]:
    parser = Balance()
    parser.feed(text)
    assert parser.open == []
    return parser.seen


def words_of(text: str) -> str:
    return re.sub(r"<[^>]*>", " ", re.sub(r"<svg.*?</svg>", " ", text, flags=re.DOTALL))


@pytest.mark.slow
@pytest.mark.parametrize("kind", EVERY_KIND)
def test_every_kind_of_decision_has_a_page(kind: str) -> None:
    text = page(view(EVERY_KIND[kind]))
    assert {"html", "article", "svg", "table"} <= elements(text)
    assert "None" not in words_of(text)
    assert "nan" not in words_of(text)


@pytest.mark.uncounted
@pytest.mark.parametrize(
    ("document", "said", "unsaid"),
    [
        (COMMIT, ["Written to the controller: Kc from 2.4 to 1.5 (x 0.625), tau_I from 150 to 250 s (x 1.67).",
                  "the loop overshot by 53% of the first peak, half-cycle decay ratio 0.45", "62% of the full change",
                  "Ms 2.88 before, Ms 1.65 after; worst case over the plausible models Ms 2.03",
                  "By eye: in manual the oscillation stops"], ["Advised"]),
        (ADVISED, ["Proposed, not written: Kc from 2.4 to 1.5"], ["Written"]),
        (REFUSED, ["Refused: not robust even at a quarter of the change.", "Nothing was changed.",
                   "worst case unstable"], ["Written"]),
        (RESTORED, ["Rolled back to the previous settings", "The loop responds worse than predicted."],
         ["<h3>Proof", "<h3>Cause", "<h3>Proposal", "accepted"]),
        (PATTERN, ["Rule pattern, from the response pattern, without a model."],
         ["<h3>Proof", "<h3>Cause", "<h3>Process model"]),
        (BORROWED, ["Rule simc, tau_c 36 s, from the neighbouring regions&#39; models.", "26 +- 9 ",
                    "none of its own: estimated from neighbouring regions"], []),
    ],
)  # fmt: skip
def test_the_page_says_what_happened(document: dict[str, object], said: list[str], unsaid: list[str]) -> None:
    text = article(view(document, drawn=False))
    assert [one for one in said if one not in text] == []
    assert [one for one in unsaid if one in text] == []


def test_numbers_of_the_page_are_those_of_the_decision() -> None:
    text = words_of(article(view(drawn=False)))
    for number in (
        "2 +- 0.03",
        "240 +- 2.6",
        "9 +- 0.4",
        "26 +- 0.35",
        "1.654",
        "1.75",
        "2.1",
        "0.016 /s",
        "0.006 /s",
        "250 s",
        "30.7 deg",
        "confidence 99%",
        "0.08 degC",
        "1.3 times the noise",
    ):
        assert number in text, number
    assert "NOT passed" in text


def test_margins_in_the_page_are_those_of_the_model() -> None:
    shown = view(drawn=False)
    assert shown.before is not None
    assert shown.process.theta_s == 27.0  # half a sampling interval more than the model's
    found = margins(shown.process, shown.before)
    assert f"<td>Ms</td><td>{found.ms:.3g}</td>" in plain(article(shown))
    assert f"<td>delay margin</td><td>{found.delay_margin_s:.3g} s</td>" in plain(article(shown))


@pytest.mark.uncounted
def test_the_formula_is_shown_only_where_it_gives_the_proposal() -> None:
    proposal: Any = COMMIT["proposal"]
    assert "<pre>" not in article(view(drawn=False))
    theta, tau1 = 26.0 + 1.0 + 4.5, 240.0 + 4.5  # half rule, and half a sampling interval
    kc = tau1 / (2.0 * (36.0 + theta))
    right = changed(proposal={**proposal, "parallel": {"kp": kc, "ki": kc / tau1, "kd": 0.0}})
    text = article(view(right, drawn=False))
    assert "Kc = 244.5/(2 * (36 + 31.5))" in text
    assert (
        "With half a sampling interval added to theta, half of tau2 added to theta and half to tau1 (half rule)."
        in text
    )
    assert "Skogestad 2003" in text


@pytest.mark.slow
@pytest.mark.uncounted
def test_no_text_becomes_markup() -> None:
    bad = '<script>alert("x")</script>&'
    document = changed(loop=bad, region=bad, reason=bad, mode=bad, code=bad)
    assert "script" not in elements(page(view(document, unit="<b>&$x$</b>")))
    assert "<b>&$x" not in page(view(document, unit="<b>&$x$</b>"))


@pytest.mark.uncounted
def test_a_promise_is_told_with_its_spread_and_the_settings_before() -> None:
    text = words_of(article(view(drawn=False)))
    for told in (
        "106.5 (103 .. 110)",
        "5 % (0 .. 8)",
        "61 %",
        "165 s (163 .. never at rest)",
        "never at rest",
        "over the 5 plausible models",
        "Predicted Ms: 1.56 (1.5 .. 1.72).",
    ):
        assert told in text, told
    promise: Any = COMMIT["promise"]
    without = words_of(article(view(changed(promise={**promise, "ms": None}), drawn=False)))
    assert "Predicted Ms" not in without


def test_a_judged_response_shows_measured_beside_promised() -> None:
    text = plain(article(view(RESTORED, drawn=False)))
    assert (
        "<td>half-cycle decay ratio, as judged</td><td>0.6</td><td>0.1</td><td>0.25</td><td>never at rest</td>" in text
    )
    assert "plausible models</td><td>2.64</td><td>1.56</td><td>2.1</td><td>unstable</td>" in text
    assert "relative to the previous settings</td><td>0.8</td><td></td><td>1.5</td><td></td>" in text
    assert "<p>Worse than predicted: half-cycle decay ratio 0.60.</p>" in text
    assert "Kc from 1.5 to 2.4" in text


def test_the_page_of_a_change_tells_what_came_of_it() -> None:
    told = changed(
        number=10, t_s=2500.0, action="none", judgement={**WORSE, "finding": "inconclusive", "reason": "cut"}
    )
    elsewhere = changed(number=11, region="low", judgement=WORSE)
    later = what_came_of(COMMIT, [COMMIT, told, elsewhere, {**RESTORED, "number": 12}, {**told, "number": 13}])
    assert [one["number"] for one in later] == [10, 12]
    text = article(replace(view(drawn=False), later=later))
    assert "Not judged: cut." in text
    assert "Then rolled back: Kc 1.5 tau_I 250 s -&gt; Kc 2.4 tau_I 150 s" in text
    assert what_came_of(REFUSED, [COMMIT, told]) == ()


def test_pages_are_for_what_changes_and_the_newest_of_the_rest() -> None:
    fine = changed(number=1, action="none", verdict=None, diagnosis={"cause": "ok"})
    cause = changed(number=2, t_s=1.0, action="none", verdict=None, diagnosis={"cause": "external"})
    refused, commit = {**REFUSED, "number": 3, "t_s": 2.0}, {**COMMIT, "number": 4, "t_s": 0.5}
    found = [fine, cause, refused, commit]
    assert [one["number"] for one in worth_pages(found, 9)] == [2, 3, 4]
    assert [one["number"] for one in worth_pages(found, 2)] == [3, 4]


def test_one_line_says_the_same_in_short() -> None:
    assert one_line(COMMIT).split(" | ") == [
        "setpoint response, overshoot 53%, half-cycle decay ratio 0.45, period 190 s",
        "aggressive: Ms 2.88 is over 1.8, gain margin 1.72",
        "k 2 tau1 240 s tau2 9 s theta 26 s (2 records)",
        "written: Kc 2.4 tau_I 150 s -> Kc 1.5 tau_I 250 s, Ms 2.88 -> 1.65 (worst case 2.03, 62% of the full change)",
    ]
    assert one_line(REFUSED).endswith("theta 26 s (2 records) | no change")
    assert one_line(RESTORED) == (
        "undecided: the loop responds worse than predicted | rolled back: Kc 1.5 tau_I 250 s -> Kc 2.4 tau_I 150 s"
    )
    assert "(from neighbouring regions) | written" in one_line(BORROWED)
    assert one_line(PATTERN).endswith("| written: Kc 2.4 tau_I 150 s -> Kc 1.5 tau_I 250 s")


def test_the_circle_is_the_guards_limit() -> None:
    assert ms_limit(view()) == 1.75
    assert ms_limit(view(changed(verdict={"checks": [{"name": "ms_nominal", "limit": 0.5}]}))) == 1.75


ODD = st.one_of(
    st.none(),
    st.just(math.inf),
    st.just(math.nan),
    st.text(max_size=5),
    st.floats(),
    st.booleans(),
    st.just([]),
    st.just({}),
    st.just([{}]),
    st.integers(-5, 5),
)


def paths(document: object, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where the values of a document are."""
    found: list[tuple[Any, ...]] = [at] if at else []
    if isinstance(document, Mapping):
        for name, value in document.items():
            found += paths(value, (*at, name))
    return found


def with_value(document: dict[str, Any], at: tuple[Any, ...], value: object) -> dict[str, Any]:
    """The document with one value replaced, or left out where the value is ...; nothing where its place is gone."""
    whole = dict(document)
    if len(at) == 1:
        whole[at[0]] = value
        if value is ...:
            del whole[at[0]]
    elif isinstance(whole.get(at[0]), Mapping):
        whole[at[0]] = with_value(dict(whole[at[0]]), at[1:], value)
    return whole


@given(st.lists(st.tuples(st.sampled_from(paths(COMMIT)), st.one_of(ODD, st.just(...))), min_size=1, max_size=6))
def test_odd_and_missing_values_leave_a_page(changes: list[tuple[tuple[Any, ...], object]]) -> None:
    document = dict(COMMIT)
    for at, value in changes:
        document = with_value(document, at, value)
    shown = DecisionView(document, None, "degC", 2.0)
    with pytest.MonkeyPatch.context() as patch:  # drawings have tests of their own
        patch.setattr(robustness_drawing, "robustness_svg", lambda *_: "")
        text = article(shown)
    elements(text)
    assert headline(shown)


# The page says on which process its curves rest where this record does not bear it out.


KNOWN = {"model": {**MODEL, "k": 1.4}, "std": {"k": 0.42}}
FOUND: Any = COMMIT["estimate"]
VAGUE = {**FOUND, "identifiable": False, "reason": "k is known to 80 % only"}
RESTS = "Curves, margins and predictions use "
BEFORE = f"{RESTS}the model before this record (k 1.4 +- 0.42 (30.0%) degC/%, "
APART = " The proposal does not use it."


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "begins", "ends"),
    [
        (
            {"surprise": "odd"},
            BEFORE,
            "This record contradicts it: on its own it gives k 2 tau1 240 s tau2 9 s theta 26 s.",
        ),
        (
            {"surprise": "odd", "estimate": VAGUE, "basis": "pattern"},
            BEFORE,
            f"theta 26 s (not identified either: k is known to 80 % only).{APART}",
        ),
        (
            {"surprise": "silent", "estimate": VAGUE, "basis": "pattern"},
            BEFORE,
            f", which does not identify the process.{APART}",
        ),
        (
            {"surprise": "agrees", "estimate": VAGUE, "basis": "slow_oscillation"},
            f"{RESTS}a model that is not accurate enough yet (k 1.4 +- 0.42 (30.0%) degC/%, ",
            f": k is known to 80 % only.{APART}",
        ),
    ],
)
def test_curves_that_the_record_does_not_bear_out_say_so(parts: dict[str, object], begins: str, ends: str) -> None:
    shown = view(changed(known=KNOWN, **parts), drawn=False)
    told = footing(shown)
    assert told.startswith(begins)
    assert told.endswith(ends)
    assert told in article(shown)


@pytest.mark.parametrize("surprise", ["first", "agrees", "changed", "opened", None])
def test_curves_that_the_record_bears_out_need_no_word(surprise: str | None) -> None:
    shown = view(changed(known=KNOWN, surprise=surprise), drawn=False)
    assert footing(shown) == ""
    assert "contradicts" not in robustness(shown)


def test_without_a_process_there_is_nothing_to_rest_on() -> None:
    assert footing(view(changed(estimate=None, verdict=None, surprise="odd"), drawn=False)) == ""


def test_ms_of_a_contradicted_process_is_not_told_as_if_it_held() -> None:
    shown = view(changed(known=KNOWN, surprise="odd"), drawn=False)
    assert robustness(shown).startswith("On the identified process, which this record contradicts: Ms 2.88 before")
