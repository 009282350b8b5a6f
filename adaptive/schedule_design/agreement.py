"""How far the stretches agree on the curves through them, and what that says of how well the curves are known.

No equation is quite a plant's, no curve quite its own, and what is wrong with either looks in each stretch as if ln p
were another there: a lag twice too long on the way up and too short on the way down. So the stretches are allowed to
differ, ln p = curve + d_j with d_j ~ N(0, V), V diagonal, and V is what makes what is left likeliest:

    ln L(V) = sum_j  1/2 g_j' (V^-1 + I_j)^-1 g_j - 1/2 ln det(I + V I_j)
    g_j = -A_j' r_j / c,  I_j = A_j' A_j / c

with A_j = dr_j/d(ln p) of a whole stretch (random effects: Laird and Ware 1982). What the stretches say together is
then a parabola of the coefficients, that of curves through local models which differ by V, instead of one that believes
every sample of every stretch.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from retuner.adaptive.schedule_design.joint import At, CurveForm
from retuner.adaptive.schedule_design.record_stretches import LEVEL_STD
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

DIFFERENCES = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0)  # standard deviations of ln p between stretches that are tried
VARIANCE_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class CurvesAgreement:
    """differences : standard deviation of each ln p between the stretches.

    normal, right : of the coefficients z, prior included: what is left is z' normal z / 2 - right' z and a constant.
    """

    differences: tuple[float, ...]
    normal: FloatArray
    right: FloatArray


@dataclass(frozen=True, slots=True)
class _StretchPiece:
    """One stretch by what its samples say: of ln p as a whole (information, score), of the coefficients, of both."""

    information: FloatArray
    score: FloatArray
    coefficients: FloatArray
    mixed: FloatArray
    pull: FloatArray

    @classmethod
    def of(cls, a: FloatArray, j: FloatArray, r: FloatArray) -> "_StretchPiece":
        """a : dr/d(ln p). j : dr/dz."""
        return cls(a.T @ a, -a.T @ r, j.T @ j, a.T @ j, -j.T @ r)

    def likelihood(self, v: FloatArray) -> float:
        """ln L of these variances."""
        s, inner = self._within(v)
        pulled = s * self.score
        return 0.5 * float(pulled @ np.linalg.solve(inner, pulled)) - 0.5 * float(np.linalg.slogdet(inner)[1])

    def known(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What it says of the coefficients when its ln p may differ by v: information and score."""
        s, inner = self._within(v)
        share = s[:, None] * self.mixed
        solved = np.linalg.solve(inner, np.concatenate([share, (s * self.score)[:, None]], axis=1))
        return self.coefficients - share.T @ solved[:, :-1], self.pull - share.T @ solved[:, -1]

    def _within(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        s = np.sqrt(v)
        return s, np.eye(len(v)) + s[:, None] * self.information * s


def agreement(form: CurveForm, now: At, sizes: Sequence[int], c: float) -> CurvesAgreement:
    """The agreement of a fit with its derivatives.

    sizes : rows of r by stretch. c : variance of r over that of white noise.
    """
    assert now.jacobian is not None
    whole = np.stack([now.jacobian[:, place.start] / LEVEL_STD for place in form.places], axis=1) / np.sqrt(c)
    j, r = now.jacobian / np.sqrt(c), now.r / np.sqrt(c)
    ends = np.cumsum([0, *sizes]).tolist()
    pieces = [_StretchPiece.of(whole[first:end], j[first:end], r[first:end]) for first, end in pairwise(ends)]
    # the variances with the largest likelihood, one after the other
    count = len(form.places)
    v = np.zeros(count)
    for _ in range(VARIANCE_ROUNDS):
        for i in range(count):
            tried = {std: v.copy() for std in DIFFERENCES}
            for std, other in tried.items():
                other[i] = std**2
            v = max(tried.values(), key=lambda other: sum(piece.likelihood(other) for piece in pieces))
    normal, right = np.zeros((form.size, form.size)), np.zeros(form.size)
    for piece in pieces:
        information, score = piece.known(v)
        normal += information
        right += information @ now.z + score
    return CurvesAgreement(tuple(np.sqrt(v).tolist()), normal + np.eye(form.size), right)
