"""The words in which this program speaks to people: the trade's, one word for a thing, each with its meaning.

    python scripts/document_vocabulary.py    # writes them into docs/concepts.md

Screens, reports, pages, help, errors and docs keep to them; tests/app/test_words.py holds that. Names in the code, keys
of JSON documents and of ledger rows are contracts and may be older words.
"""

import re
from pathlib import Path
from typing import NamedTuple

PAGE = Path(__file__).resolve().parent.parent / "docs" / "concepts.md"
BEGIN = "<!-- written by scripts/document_vocabulary.py -->\n"
COLUMNS = "| term | meaning | source |\n|---|---|---|\n"


class Term(NamedTuple):
    """A word of the trade.

    term : the word. meaning : in a sentence or two. old : words that it replaces, as regular expressions that match
    whole words. source : author and year, or the standard, where the word is used so.
    """

    term: str
    meaning: str
    old: tuple[str, ...] = ()
    source: str = ""


TERMS = (
    Term("process variable, pv", "The measured value that the loop controls.", (), "ISA-51.1"),
    Term("setpoint, sp", "The value that pv should have.", (), "ISA-51.1"),
    Term("controller output, co", "What the controller sends to the actuator, in % of its range.", (), "ISA-51.1"),
    Term("load disturbance, load step", "A disturbance at the process input, as a step.", (), "Astrom & Hagglund 2006"),
    Term("dead time, theta", "Time before pv begins to answer co.", (), "ISA-51.1"),
    Term("lag, tau1, tau2", "Time constants of the process.", (), "ISA-51.1"),
    Term(
        "closed-loop time constant, tau_c",
        "The tuning parameter of SIMC, lambda of lambda tuning: small is fast, large is robust.",
        (),
        "Skogestad 2003",
    ),
    Term(
        "sensitivity peak, Ms",
        "Largest factor by which the loop amplifies a disturbance: 1.2 is calm, 1.6 usual, over 2 oscillatory.",
        (),
        "Astrom & Hagglund 2006",
    ),
    Term("IAE", "Integral of the absolute error; per unit step where two responses are compared."),
    Term(
        "half-cycle decay ratio",
        "Height of a half cycle over that of the one before: 0 dead-beat, 1 sustained. It is (E3-E2)/(E1-E2) of the "
        "peaks E1, E2, E3 of the error. Its square is the decay ratio over a whole cycle: quarter decay is 0.5.",
        (r"damping(?! (ratio|factor))", r"successive peaks"),
        "Foxboro TI 039-200; Wade 2004",
    ),
    Term("stiction", "Static friction of a valve: it sticks, then jumps.", (), "Choudhury, Thornhill & Shah 2005"),
    Term(
        "stiction band",
        "How far co moves before a sticking valve moves, in % of co; deadband plus stickband.",
        (r"stick bands?", r"band of the valve"),
        "Choudhury, Thornhill & Shah 2005",
    ),
    Term(
        "external oscillation",
        "An oscillation that another loop or machine brings into this one.",
        (r"tones? from outside", r"an oscillation from outside"),
        "Thornhill & Horch 2007",
    ),
    Term(
        "log-likelihood ratio",
        "Logarithm of how much likelier a record is under one explanation than under another; above 5 is strong "
        "evidence.",
        (r"odds of e\^", r"what the (tone|sticking valve) gains"),
        "Kass & Raftery 1995",
    ),
    Term("record", "Samples of one response, or a file of samples, from which a model is made."),
    Term("response", "What pv does after a setpoint change or a load step, until it settles."),
    Term(
        "update the model",
        "Improve a region's process model with a new record; a record that tells nothing is not used.",
        (r"teach(es)?", r"it teaches nothing", r"nothing is learned"),
    ),
    Term(
        "plausible models",
        "The process models that agree with the records within their noise. Changes are proved on all of them.",
        (r"models? that the records? (still )?allows?", r"models? (that (is|are) )?still allowed"),
    ),
    Term("nominal, worst case", "On the identified process; on the worst of the plausible models.", (r"at worst",)),
    Term("region", "A part of the operating range with gains of its own."),
    Term("region boundary", "Where two regions meet.", (r"borders?",)),
    Term(
        "baseline gains",
        "The gains of the configuration, with which the loop was started up.",
        (r"(un)?commissioned( set)?",),
    ),
    Term("active gains", "The gains that the controller runs now.", (r"in force", r"running sets?")),
    Term("verified gains", "The last gains that passed a trial, or the baseline gains.", (r"verified set",)),
    Term(
        "trial",
        "The time after a change of gains in which responses are compared with the predicted performance.",
        (r"tried sets?", r"sets? on trial"),
    ),
    Term("trial gains", "Gains that are on trial."),
    Term(
        "predicted performance",
        "Overshoot, decay ratio, IAE and Ms that the plausible models predict for a change. The trial is judged by it.",
        (r"promis(e|es|ed|ing)",),
    ),
    Term(
        "rolled back, rollback",
        "The earlier gains are written again, because responses were worse than predicted or an operator asked.",
        (r"(take|takes|taken|took|taking) back", r"undo(es|ne|ing|s)?", r"ways? back", r"put back"),
    ),
    Term(
        "operator",
        "Whoever is responsible for the loop, and approves, rejects or edits.",
        (r"a person('s)?", r"persons?", r"somebody"),
    ),
    Term(
        "operator approval",
        "The word of an operator that a proposed or tried change may be written or stay.",
        (r"waits? for a (word|person)", r"ha(s|ve) the (next )?word", r"waits for your word"),
    ),
    Term("operator request", "An approval, rejection, rollback, unlock or change of mode, with its author and time."),
    Term("locked", "A region in which nothing is changed until an operator unlocks it.", (r"locked out",)),
    Term("accepted, cut, refused", "What the checks before a write did with a proposal.", (r"let(s)? through",)),
    Term("model accuracy", "Standard deviations of the model's parameters.", (r"known well enough",)),
    Term("write access, lease", "The right of one host to write gains, for a limited time."),
    Term("ledger", "The audit trail: what was seen, decided and written, in a chain of hashes."),
    Term("depends on", "One thing changes with another.", (r"hangs? on",)),
)
"""All terms, in the order of the page."""


def page() -> str:
    """The page as Markdown, with the terms at its end."""
    before, mark, _ = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return before + mark + COLUMNS + "".join(map(_row, TERMS))


def _row(term: Term) -> str:
    return f"| **{re.sub('[|]', '/', term.term)}** | {term.meaning} | {term.source} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
