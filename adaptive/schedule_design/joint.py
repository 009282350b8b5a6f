"""All stretches and the curves through them: one misfit, its derivatives, and its smallest value.

    r = white(pv - y(z) - start - slope - loads) / sigma,      least |r|^2 + |z|^2

Start, slope and load steps of each stretch enter linearly and are solved for (variable projection, Kaufman's
derivatives, 1975). What is left is filtered white by one autoregression, and every stretch counts by what it leaves, so
that one with an upset that nothing explains does not speak loudest.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.fit.levenberg_marquardt import Limits, descended
from retuner.adaptive.schedule_design.motion import Batch, Local, drifted, push_ways, response
from retuner.adaptive.schedule_design.record_stretches import Characteristic, CurveAxis, CurveShape, Second, Stretch
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, median
from retuner.schedule.late_dataclass import dataclass, replace

STEP = 1e-4  # step of z for derivatives
LIMITS = Limits(30, 12, 0.02, damping=1e-3, least=1e-9, in_all=30)
LARGEST_MOVE = 0.7  # Largest change of any ln p in one iteration
WIDTH = 48  # stretches simulated side by side


@dataclass(frozen=True, slots=True)
class CurveForm:
    """What is fitted. shapes : of ln b, ln theta, ln tau and, where there is a second lag, ln tau2.

    centre : of the prior of each. sign : of the process gain. axis : see Axis. felt : how co acts; its coefficients
    stand behind the shapes' in z. pushed : the variable comes from outside and moves pv by itself as well: it
    enters as a load does, with sizes of its own in each stretch, by the ways of motion.push_ways.
    second : another variable beside it; its coefficients stand last.
    """

    axis: CurveAxis
    shapes: tuple[CurveShape, ...]
    centre: tuple[float, ...]
    sign: int
    felt: Characteristic | None = None
    pushed: bool = False
    second: Second | None = None

    @property
    def size(self) -> int:
        """Number of coefficients z."""
        return int(self.felt_place.stop) + (0 if self.second is None else sum(self.second.sizes))

    @property
    def places(self) -> tuple[slice, ...]:
        """Where each parameter's coefficients stand in z."""
        ends = np.cumsum(self.shapes).tolist()
        return tuple(slice(end - int(shape), end) for end, shape in zip(ends, self.shapes, strict=True))

    def curves(self, x: FloatArray, z: FloatArray, x2: FloatArray | None = None) -> list[FloatArray]:
        """ln p at x (and x2) for each variant of z, shape (size, variants): each (*x.shape, variants)."""
        found = [
            centre + self.axis.columns(x, shape) @ z[place]
            for centre, shape, place in zip(self.centre, self.shapes, self.places, strict=True)
        ]
        if x2 is None:
            return found
        return [one + more for one, more in zip(found, self.beside(x2, z), strict=True)]

    def beside(self, x2: FloatArray, z: FloatArray) -> list[FloatArray]:
        """What the second variable adds to each ln p: arguments and shapes as `curves`."""
        if self.second is None:
            return [np.zeros((*x2.shape, z.shape[1]))] * len(self.shapes)
        return [self.second.columns(x2, i) @ z[place] for i, place in enumerate(self.second_places)]

    @property
    def second_places(self) -> tuple[slice, ...]:
        """Where each parameter's coefficients over the second variable stand in z; none where there is none."""
        if self.second is None:
            return ()
        ends = (self.felt_place.stop + np.cumsum(self.second.sizes)).tolist()
        return tuple(slice(end - size, end) for end, size in zip(ends, self.second.sizes, strict=True))

    @property
    def second_shapes(self) -> tuple[CurveShape, ...]:
        """Shape of each parameter over the second variable; none where there is none."""
        return () if self.second is None else self.second.shapes

    def outside(self, batch: Batch) -> list[FloatArray]:
        """The variables that come from outside, at every row."""
        found = [batch.x] if self.pushed else []
        return found + ([batch.x2] if self.second is not None and self.second.pushed and batch.x2 is not None else [])

    def drift(self, batch: Batch, local: Local, z: FloatArray) -> FloatArray:
        """motion.drifted; nothing where no variable comes from outside."""
        if not self.outside(batch) or local.tau is None:
            return np.zeros_like(local.b)
        ln_k = local.b + local.tau
        if batch.x2 is not None and self.second is not None:
            added = self.beside(batch.x2, z)
            beside = added[0] + added[2]
            ln_k = ln_k if self.pushed and self.second.pushed else beside if self.second.pushed else ln_k - beside
        return drifted(batch, local, ln_k)

    @property
    def felt_place(self) -> slice:
        """Where the coefficients of the characteristic stand in z."""
        return slice(sum(self.shapes), sum(self.shapes) + (0 if self.felt is None else self.felt.size))

    def arriving(self, batch: Batch, local: Local, z: FloatArray) -> FloatArray:
        """What arrives between the rows at these dead times for each variant of z, as the process feels it."""
        return self.sign * batch.arriving(np.exp(local.theta), self.felt, z[self.felt_place])

    def with_shapes(
        self,
        shapes: Sequence[CurveShape],
        z: FloatArray,
        felt: Characteristic | None = None,
        second: Sequence[CurveShape] = (),
    ) -> tuple["CurveForm", FloatArray]:
        """The form with other shapes, and z carried over: what is new is zero, what goes is lost.

        second : shapes over the second variable, where there is one.
        """
        beside = None if self.second is None else replace(self.second, shapes=tuple(second))
        sizes = [*map(int, shapes), 0 if felt is None else felt.size, *(() if beside is None else beside.sizes)]
        carried = []
        for place, new in zip([*self.places, self.felt_place, *self.second_places], sizes, strict=True):
            old = z[place][:new]
            carried.append(np.pad(old, (0, new - len(old))))
        return replace(self, shapes=tuple(shapes), felt=felt, second=beside), np.concatenate(carried)


@dataclass(frozen=True, slots=True)
class Noise:
    """What is left, as noise. ar : its autoregression. sigma : of its innovations, one for each stretch."""

    ar: tuple[float, ...]
    sigma: FloatArray


@dataclass(frozen=True, slots=True)
class Joint:
    """Stretches beside each other with the load steps found in them. loads : rows in which they enter, by stretch."""

    batches: tuple[Batch, ...]
    loads: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, stretches: Sequence[Stretch]) -> "Joint":
        """Stretches by length, no loads yet."""
        ordered = sorted(stretches, key=len)
        batches = [Batch.of(ordered[i : i + WIDTH]) for i in range(0, len(ordered), WIDTH)]
        return cls(tuple(batches), ((),) * len(ordered))

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The stretches in the order of the batches."""
        return tuple(s for batch in self.batches for s in batch.stretches)


@dataclass(frozen=True, slots=True)
class At:
    """The misfit at one z. r : whitened, scaled, shape (n,). left : pv that is not explained, one array a stretch.

    jacobian : dr/dz, shape (n, size), or None. starts, sizes : slope at the start, and sizes of the loads in co units,
    behind them those of the variable's push, where it has one.
    """

    z: FloatArray
    r: FloatArray
    left: tuple[FloatArray, ...]
    jacobian: FloatArray | None
    starts: FloatArray
    sizes: tuple[FloatArray, ...]

    @property
    def cost(self) -> float:
        """Misfit with the prior's share."""
        return float(self.r @ self.r + self.z @ self.z)


def at(joint: Joint, form: CurveForm, z: FloatArray, noise: Noise, *, derivatives: bool) -> At:
    """The misfit at z, with its derivatives where they are wanted."""
    parts: list[At] = []
    done = 0
    for batch in joint.batches:
        end = done + len(batch.stretches)
        part = Noise(noise.ar, noise.sigma[done:end])
        parts.append(_at_batch(batch, joint.loads[done:end], form, z, part, derivatives=derivatives))
        done = end
    jacobian = np.concatenate([p.jacobian for p in parts if p.jacobian is not None]) if derivatives else None
    return At(
        z,
        np.concatenate([p.r for p in parts]),
        tuple(left for p in parts for left in p.left),
        jacobian,
        np.concatenate([p.starts for p in parts]),
        tuple(size for p in parts for size in p.sizes),
    )


def local_at(form: CurveForm, batch: Batch, z: FloatArray) -> Local:
    """The process at every row for each variant of z, shape (size, variants)."""
    curves = form.curves(batch.x, z, batch.x2)
    return Local(curves[0], curves[1], curves[2], curves[3] if len(curves) > 3 else None)


def _at_batch(
    batch: Batch, loads: Sequence[tuple[int, ...]], form: CurveForm, z: FloatArray, noise: Noise, *, derivatives: bool
) -> At:
    now = local_at(form, batch, z[:, None])
    arriving = form.arriving(batch, now, z[:, None])
    y = (response(now, arriving, batch.h_s) + form.drift(batch, now, z[:, None]))[..., 0]
    # What enters linearly, a stretch each, shape (rows, columns): level, slope at the start, load steps, pushes. Of
    # each load also the one a row later, so that its time need not be a row's
    rows, most, outside = len(batch.pv), 1 + max(map(len, loads), default=0), form.outside(batch)
    steps = np.zeros((rows - 1, len(batch.stretches), most))
    for j, entered in enumerate(loads):
        for i, row in enumerate(entered, 1):
            steps[row:, j, i] = 1.0
    start = np.zeros(steps.shape[1:])
    start[:, 0] = 1.0
    ones, entering = np.ones((rows, 1)), response(now.repeated(most), steps, batch.h_s, start)
    beside = np.concatenate([entering[..., :0], *push_ways(batch, now, outside)], axis=2)
    columns = [
        np.concatenate([ones, entering[:, j, : 1 + len(entered)], beside[:, j]], axis=1)
        for j, entered in enumerate(loads)
    ]
    rs, lefts, bases, starts, sizes = [], [], [], [], []
    for j, stretch in enumerate(batch.stretches):
        n = len(stretch)
        a = white(columns[j][:n], noise.ar) / noise.sigma[j]
        b = white(batch.pv[:n, j] - y[:n, j], noise.ar) / noise.sigma[j]
        q, triangle = np.linalg.qr(a)
        coefficients = np.linalg.lstsq(triangle, q.T @ b, rcond=1e-10)[0]
        rs.append(b - q @ (q.T @ b))
        lefts.append(batch.pv[:n, j] - y[:n, j] - columns[j][:n] @ coefficients)
        bases.append(q)
        starts.append(coefficients[1])
        sizes.append(coefficients[2:])
    found = At(z, np.concatenate(rs), tuple(lefts), None, np.array(starts), tuple(sizes))
    if not derivatives:
        return found
    # dr/dz with what is solved for linearly held, then projected
    variants = np.concatenate([found.z[:, None], found.z[:, None] + STEP * np.eye(form.size)], axis=1)
    local = local_at(form, batch, variants)
    arriving = form.arriving(batch, local, variants)
    for j, entered in enumerate(loads):
        for row, size in zip(entered, found.sizes[j][: len(entered)], strict=True):
            arriving[row:, j] += size
    start = np.repeat(found.starts[:, None], variants.shape[1], axis=1)
    y = response(local, arriving, batch.h_s, start)
    drift, ways = form.drift(batch, local, variants), push_ways(batch, local, outside)
    # what the variables themselves do to pv, with the sizes that are held
    held = np.stack([size[len(size) - len(ways) :] for size in found.sizes], axis=1)
    y += drift + sum(way * size[:, None] for way, size in zip(ways, held, strict=True))
    moved = (y[..., 1:] - y[..., :1]) / STEP
    slopes = []
    for j, stretch in enumerate(batch.stretches):
        a = white(moved[: len(stretch), j], noise.ar) / noise.sigma[j]
        slopes.append(-(a - bases[j] @ (bases[j].T @ a)))
    return replace(found, jacobian=np.concatenate(slopes))


def white(values: FloatArray, ar: Sequence[float]) -> FloatArray:
    """Values along the first axis through the whitening filter, which is at rest before them.

    The first rows are kept: without them a start that dies out within them would cost nothing, and grow without end.
    """
    found = values.copy()
    for k, coefficient in enumerate(ar, 1):
        found[k:] -= coefficient * values[:-k]
    return found


def refined(joint: Joint, form: CurveForm, z: FloatArray, noise: Noise, tries: int = LIMITS.in_all) -> At:
    """The smallest misfit near z, after so many tries at the most."""

    def seen(z: FloatArray, *, derivatives: bool = True) -> At:
        return at(joint, form, z, noise, derivatives=derivatives)

    start = seen(z)
    found = descended(
        (start.z, start.cost),
        seen,
        lambda z, now, damping: z + _step(form, now, damping),
        lambda z: seen(z, derivatives=False).cost,
        LIMITS._replace(in_all=tries),
    )
    assert found is not None
    return found[2]


def _step(form: CurveForm, now: At, damping: float) -> FloatArray:
    """A damped step, no ln p moved too far."""
    assert now.jacobian is not None
    normal = now.jacobian.T @ now.jacobian + np.eye(form.size)
    gradient = now.jacobian.T @ now.r + now.z
    step = -np.asarray(np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient), dtype=np.float64)
    places = form.axis.grid(9)
    moves = [c - m for c, m in zip(form.curves(places, step[:, None]), form.centre, strict=True)]
    if form.second is not None:
        moves += form.beside(form.second.axis.grid(9), step[:, None])
    if form.felt is not None:
        moves.append(form.felt.columns(form.felt.axis.grid(9)) @ step[form.felt_place, None])
    farthest = max(float(np.max(np.abs(moved))) for moved in moves)
    return np.asarray(step * min(1.0, LARGEST_MOVE / max(farthest, 1e-12)), dtype=np.float64)


MOST_ORDER = 5
PRIOR_SAMPLES = 30.0  # Samples' worth of the common sigma in each stretch's own


def noise_of(left: Sequence[FloatArray], floor: float) -> Noise:
    """The autoregression of what is left, and each stretch's innovations.

    floor : least sigma, in pv units.
    """
    around = [x - np.mean(x) for x in left if len(x) > 4 * MOST_ORDER]
    # rows of x_i, x_(i-1), ..., x_(i-MOST_ORDER)
    rows = [np.stack([x[MOST_ORDER - k : len(x) - k] for k in range(MOST_ORDER + 1)], axis=1) for x in around]
    scale = [max(float(np.std(x)), floor) for x in left if len(x) > 4 * MOST_ORDER]
    matrix = np.concatenate([m / s for m, s in zip(rows, scale, strict=True)])
    y, past = matrix[:, 0], matrix[:, 1:]
    best, ar = len(y) * math.log(max(float(y @ y), 1e-300)), ()
    for order in range(1, MOST_ORDER + 1):
        coefficients = np.linalg.lstsq(past[:, :order], y, rcond=None)[0]
        e = y - past[:, :order] @ coefficients
        criterion = len(y) * math.log(max(float(e @ e), 1e-300)) + order * math.log(len(y))
        if criterion < best:
            best, ar = criterion, tuple(coefficients.tolist())
    variances = [max(float(np.mean(white(x, ar) ** 2)), floor**2) if len(x) > len(ar) + 3 else floor**2 for x in left]
    common = median(variances)
    sizes = np.array([len(x) for x in left])
    sigma = np.sqrt((PRIOR_SAMPLES * common + sizes * np.array(variances)) / (PRIOR_SAMPLES + sizes))
    return Noise(ar, np.maximum(sigma, floor))


# ---- Where to start: one process for all stretches, over a grid of lag and dead time; and load steps, one by one

NODES = 10  # lags and dead times each
MOST_STRETCHES = 40  # stretches that are searched, those that move most; the refinement uses all
WHITENINGS: tuple[tuple[float, ...], ...] = ((), (0.97,))
"""Whitenings of the search: as measurement noise, and nearly differenced, in which slow loads weigh little. Noise
beside a controller must not be differenced: its output answers the noise at once, as if there were no dead time."""


def starts(
    stretches: Sequence[Stretch],
    axis: CurveAxis,
    sign: int | None,
    *,
    pushed: bool = False,
    second: Second | None = None,
) -> list[CurveForm]:
    """Constant processes to start from, one for each whitening; their z is zero, as the prior is centred on it.

    sign : of the process gain, where it is known. pushed, second : see Form.
    """
    form = CurveForm(axis, (CurveShape.CONSTANT,) * 3, (0.0, 0.0, 0.0), 1, pushed=pushed, second=second)
    chosen = sorted(stretches, key=_excitation, reverse=True)[:MOST_STRETCHES]
    batch = Batch.of(chosen)
    h = median(batch.h_s)
    longest = h * max(map(len, chosen))
    lags = np.geomspace(2 * h, 3 * longest, NODES)
    thetas = np.geomspace(0.5 * h, 0.3 * longest, NODES)
    best = [(math.inf, 0.0, 0.0, 0.0)] * len(WHITENINGS)
    for theta in thetas.tolist():
        # misfit and slope gain for each whitening and lag, at one dead time
        shape = (len(batch.pv), len(batch.stretches), len(lags))
        ln_tau = np.broadcast_to(np.log(lags), shape)
        local = Local(np.zeros(shape), np.full(shape, math.log(theta)), ln_tau, None)
        arriving = np.repeat(batch.arriving(np.full((*shape[:2], 1), theta)), len(lags), axis=2)
        moved = response(local, arriving, batch.h_s)
        begun = response(local, np.zeros_like(arriving), batch.h_s, np.ones(shape[1:]))
        beside = np.stack([begun, *push_ways(batch, local, form.outside(batch))], axis=-1)
        for w, found in enumerate(
            [[_node(batch, moved[..., i], beside[..., i, :], ar) for i in range(len(lags))] for ar in WHITENINGS]
        ):
            nodes = zip(lags.tolist(), found, strict=True)
            right = [(cost, slope, theta, lag) for lag, (cost, slope) in nodes if sign is None or slope * sign > 0]
            best[w] = min(best[w], *right, (math.inf, 0.0, 0.0, 0.0))
    found_any = [node for node in dict.fromkeys(best) if node[0] < math.inf]
    if not found_any:
        raise ValueError("pv goes against co everywhere, where the controller says otherwise: are the columns right?")
    made = []
    for _, slope, theta, lag in found_any:
        centre = (math.log(max(abs(slope), 1e-300)), math.log(theta), math.log(lag))
        made.append(replace(form, centre=centre, sign=1 if slope >= 0 else -1))
    return made


def _excitation(stretch: Stretch) -> float:
    return float(np.ptp(stretch.pv)) / max(noise_sigma(stretch.pv), 1e-12 * float(np.ptp(stretch.pv)) + 1e-300)


def _node(batch: Batch, moved: FloatArray, beside: FloatArray, ar: Sequence[float]) -> tuple[float, float]:
    """Misfit and slope gain of one process, start and slope of every stretch, and its push, solved for."""
    xx = xy = yy = 0.0
    for j, stretch in enumerate(batch.stretches):
        n = len(stretch)
        columns = np.stack([np.ones(n), *beside[:n, j].T, moved[:n, j], batch.pv[:n, j]], axis=1)
        triangle = np.linalg.qr(white(columns, ar) / max(noise_sigma(stretch.pv), 1e-9))[1]
        a, b, c = triangle[-2, -2], triangle[-2, -1], triangle[-1, -1]
        xx, xy, yy = xx + a**2, xy + a * b, yy + b**2 + c**2
    slope = float(xy / max(xx, 1e-300))
    return float(yy - xy * slope), slope


COARSE = 6  # every so many rows a load step is tried, then every row near the best
MOST_LOADS = 4  # load steps in a stretch
LOAD_STEP_PRICE = 12.0  # fall of the misfit, beyond 2 ln n, that a load step must bring


def with_loads(joint: Joint, form: CurveForm, now: At, noise: Noise) -> Joint:
    """The stretches with the load steps that pay for the curves as they are at `now`."""
    loads: list[tuple[int, ...]] = []
    done = 0
    for batch in joint.batches:
        local = local_at(form, batch, now.z[:, None])
        arriving = form.arriving(batch, local, now.z[:, None])
        explained = (response(local, arriving, batch.h_s) + form.drift(batch, local, now.z[:, None]))[..., 0]
        # what a slope at the start and the variable's push, and a load step that enters at each row, do to pv
        rows, count = batch.pv.shape
        entered = np.broadcast_to(
            (np.arange(rows - 1)[:, None] >= np.arange(rows))[:, None, :], (rows - 1, count, rows)
        )
        by_load = response(local.repeated(rows), entered.astype(np.float64), batch.h_s)
        begun = response(local, np.zeros((rows - 1, count, 1)), batch.h_s, np.ones((count, 1)))
        beside = np.concatenate([begun, *push_ways(batch, local, form.outside(batch))], axis=2)
        theta, tau = (float(np.exp(median(p))) for p in (local.theta, local.b * 0 if local.tau is None else local.tau))
        for j, stretch in enumerate(batch.stretches):
            n, h = len(stretch), stretch.signals.h_s
            y = white(stretch.pv - explained[:n, j], noise.ar) / noise.sigma[done]
            rest = [np.ones(n), *beside[:n, j].T]
            columns = white(np.stack(rest, axis=1), noise.ar) / noise.sigma[done]
            barred = int((2 * theta + 0.2 * tau) / h) + 4 if stretch.changed else 0
            steps = white(by_load[:n, j], noise.ar) / noise.sigma[done]
            # rows of the load steps that pay, one after the other, none within COARSE rows of another
            allowed = range(max(barred, 3), n - max(6, int(theta / h)))
            chosen: list[int] = []
            price = LOAD_STEP_PRICE + 2 * math.log(max(len(y), 2))
            while len(chosen) < 2 * MOST_LOADS:
                q = np.linalg.qr(np.concatenate([columns, steps[:, chosen]], axis=1))[0]
                left = y - q @ (q.T @ y)
                free = [row for row in allowed if all(abs(row - c) > COARSE for c in chosen)]
                if not free:
                    break
                tried = steps[:, free] - q @ (q.T @ steps[:, free])
                size = np.einsum("ij,ij->j", tried, tried)
                fall = np.where(size > 1e-9, (left @ tried) ** 2 / np.maximum(size, 1e-300), 0.0)
                best = int(np.argmax(fall))
                if fall[best] < price:
                    break
                chosen += [free[best], free[best] + 1]  # between the two lies the time at which it entered
            loads.append(tuple(sorted(chosen)))
            done += 1
    return replace(joint, loads=tuple(loads))
