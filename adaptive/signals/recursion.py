"""First-order recursion over a signal, without a loop over its samples where the decay is the same for all.

x_0 = 0,   x_(i+1) = decay_i x_i + moved_i
"""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]  # real or complex, shape (n,): a mode is either

BLOCK = 32  # samples that one product of matrices takes at a time
AGO = BLOCK - 1 + np.arange(BLOCK)[:, None] - np.arange(BLOCK)
"""Place of decay^(i - k) among powers that BLOCK - 1 zeros go before."""


def recursion(decay: Array, moved: Array) -> Array:
    """x of the head of this file, shape (len(moved) + 1,). decay : one, or one for each of moved."""
    decay = np.asarray(decay)
    if decay.ndim == 0:
        # by blocks: within one, a triangle of powers of the decay; from one to the next, what is left of the last
        n = len(moved)
        powers = np.zeros(2 * BLOCK, dtype=decay.dtype)
        powers[BLOCK - 1 :] = decay ** np.arange(BLOCK + 1)
        padded = np.zeros(-(-n // BLOCK) * BLOCK, dtype=np.result_type(decay, moved))
        padded[:n] = moved
        inside = padded.reshape(-1, BLOCK) @ powers[AGO].T
        carried, now, whole = [], 0.0 * powers[-1].item(), powers[-1].item()
        for last in inside[:, -1].tolist():
            carried.append(now)
            now = whole * now + last
        inside += np.array(carried)[:, None] * powers[BLOCK:]
        return np.concatenate([[0.0], inside.ravel()[:n]])
    x = np.empty(len(moved) + 1, dtype=np.result_type(decay, moved))
    now = x[0] = 0.0
    for i, (a, step) in enumerate(zip(decay.tolist(), moved.tolist(), strict=True), 1):
        now = a * now + step
        x[i] = now
    return x
