"""A decision's document (decision_document.py) as HTML: a page of its own, or a part of another."""

from retuner.decision_page.decision_document import decision_document
from retuner.decision_page.decision_sentences import ms_limit
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.response_drawing import response_svg
from retuner.decision_page.robustness_drawing import robustness_svg
from retuner.templates import rendered


def page(view: DecisionView) -> str:
    """The page as an HTML document of its own."""
    return _rendered("decision_page.html.jinja", view)


def article(view: DecisionView) -> str:
    """The page as a part of another."""
    return _rendered("decision.html.jinja", view)


def _rendered(template: str, view: DecisionView) -> str:
    drawings = {"response": response_svg(view), "robustness": robustness_svg(view, ms_limit(view))}
    told = decision_document(view)
    return rendered(template, title=told.title, decision=told, drawings=drawings)
