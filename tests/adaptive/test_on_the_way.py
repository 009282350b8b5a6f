"""A linear model of a response that went somewhere says less of its region the farther it went."""

import math

import numpy as np
import pytest

from retuner.adaptive.identification.estimate import LogModel, ModelEstimate
from retuner.adaptive.identification.plausible import OUT, Plausible
from retuner.adaptive.region_model.from_neighbours import as_wide_as_known
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.update import Agreement, Learned, TrackerSettings, on_the_way, scattered

SETTINGS = TrackerSettings(scatter=0.06)
UNTOLD = ModelEstimate(False, "nothing seen", (), 0.0, 0.0, ())
LOG = LogModel(np.log([0.02, 8.0, 100.0]), 1e-4 * np.eye(3), 1)


def learned(agreement: Agreement) -> Learned:
    only_best = (Plausible(LOG.model(), 0.0),)
    model = RegionModel((StructureModel(scattered(LOG, SETTINGS), -500.0),), 1, 0.0, plausible=only_best)
    return Learned(model, UNTOLD, agreement, 0.0)


@pytest.mark.parametrize("share", [0.0, 0.03, 0.1, 0.3, 1.0, 3.0])
def test_records_scatter_by_the_curves_prior_between_the_ends_of_the_way(share: float) -> None:
    """Beyond the end of an axis as well."""
    assert on_the_way(SETTINGS, share).scatter == pytest.approx(min(math.hypot(0.06, 1.4 * share), 1.5))
    assert on_the_way(SETTINGS, share).gate == SETTINGS.gate


def test_what_is_learned_is_allowed_as_far_out_as_its_covariance_says() -> None:
    found = as_wide_as_known(learned(Agreement.FIRST)).region_model
    farthest = max(abs(math.log(one.model.theta_s / LOG.model().theta_s)) for one in found.plausible)
    assert farthest == pytest.approx(OUT * math.sqrt(1e-4 + 0.06**2), rel=1e-3)
    assert found.plausible[0] == Plausible(LOG.model(), 0.0)


@pytest.mark.parametrize("agreement", [Agreement.SILENT, Agreement.CONTRADICTS])
def test_what_was_not_believed_opens_nothing(agreement: Agreement) -> None:
    before = learned(agreement)
    assert as_wide_as_known(before) is before


def test_nothing_known_stays_nothing() -> None:
    nothing = Learned(None, UNTOLD, Agreement.FIRST, 0.0)
    assert as_wide_as_known(nothing) is nothing
