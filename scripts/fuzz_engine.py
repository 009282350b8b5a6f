"""Throws anything at the compiled engine's doors: it must answer or raise ValueError in one line, and never crash.

    python scripts/fuzz_engine.py [--seed 1] [--calls 20000]
    python scripts/fuzz_engine.py --sanitize       the same with the address and undefined-behaviour sanitizers

Random sizes, wrong lengths, NaN, infinities, huge and tiny numbers, empty and read-only buffers, buffers of other
types, counts that do not fit. Every call begins as a proper one, of which some arguments are then spoilt. --sanitize
compiles the extension into a folder of its own and runs itself there, with the sanitizers' library loaded first.
"""

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from array import array
from collections.abc import Callable
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "adaptive" / "fit" / "_engine.c"
SIZE = (3, 4, 2, 3, 5, 5)
SECOND = (False, True, False, True, True, True)
SPECIAL = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    1e-320,
    1e-300,
    -1e300,
    1e300,
    700.0,
    -700.0,
    float("nan"),
    float("inf"),
    -float("inf"),
)


def numbers(random: Random, count: int) -> "array[float]":
    """Random numbers about one in size."""
    return array("d", (random.gauss(0, 1) for _ in range(count)))


def record(random: Random) -> list[Any]:
    """t, pv, co and the head of a problem."""
    n, dt, even = random.randint(3, 60), 10 ** random.uniform(-3, 3), random.random() < 0.5
    steps = [dt if even else dt * random.uniform(0.1, 2) for _ in range(n)]
    t = array("d", (sum(steps[:i]) for i in range(n)))
    type_, loads, rounded, ramp = (
        random.randrange(len(SIZE)),
        random.randint(0, 3),
        random.randint(0, 1),
        random.randint(0, 1),
    )
    motion, harmonics, starts, order = (random.randint(0, 1), random.choice((0, 0, 2)), random.randint(0, 3),
                                        random.randint(0, 4))  # fmt: skip
    priors = starts * (1 + SECOND[type_] + 2 * motion) + ramp
    head = [dt if even else 0.0, max(t[-1], dt), 10 ** random.uniform(-6, 3), random.choice((-1.0, 1.0)), type_, loads,
            harmonics, ramp, rounded, random.randint(0, loads), motion, starts, order]  # fmt: skip
    tail = [random.uniform(0, t[-1]) for _ in range(starts)] + [random.uniform(-0.5, 0.5) for _ in range(order)]
    return [t, numbers(random, n), numbers(random, n), array("d", [*head, *tail, *(0.1 for _ in range(priors))])]


def sizes(arguments: list[Any]) -> tuple[int, int, int, int, int]:
    """n, size of p, its process part, columns and priors of a problem."""
    head = [int(x) for x in arguments[3][4:13]]
    type_, loads, harmonics, ramp, rounded, _, motion, starts, _ = head
    priors = starts * (1 + SECOND[type_] + 2 * motion) + ramp
    size = SIZE[type_] + loads + rounded + (harmonics > 0)
    return len(arguments[0]), size, SIZE[type_], priors + loads + 2 * harmonics + 1, priors


def zeros(count: int) -> "array[float]":
    """Room for an answer."""
    return array("d", bytes(8 * count))


def call_refine(random: Random) -> list[Any]:
    """Proper arguments of refine."""
    given = record(random)
    n, size, d, _, _ = sizes(given)
    known = random.randint(0, 3)
    low, high = array("d", [-random.uniform(1, 50)] * size), array("d", [random.uniform(1, 50)] * size)
    return [*given, numbers(random, size), low, high, array("d", [1.0] * size), numbers(random, known * d),
            numbers(random, known), zeros(n), random.randint(0, 12), 1e-5]  # fmt: skip


def call_costs(random: Random) -> list[Any]:
    """Proper arguments of costs."""
    given = record(random)
    points = random.randint(0, 3)
    return [*given, numbers(random, points * sizes(given)[1]), zeros(points)]


def call_project(random: Random) -> list[Any]:
    """Proper arguments of project."""
    given = record(random)
    n, size, _, k, priors = sizes(given)
    return [*given, numbers(random, size), zeros(k * (n + priors)), zeros(n + priors + 1), zeros(k), zeros(n),
            zeros(k * n), zeros(k * k)]  # fmt: skip


def call_jacobian(random: Random) -> list[Any]:
    """Proper arguments of jacobian."""
    given = record(random)
    n, size, _, _, priors = sizes(given)
    return [*given, numbers(random, size), zeros(size * (n + priors + 1))]


def call_gains(random: Random) -> list[Any]:
    """Proper arguments of gains."""
    given, many = record(random), random.randint(0, 5)
    return [*given, numbers(random, sizes(given)[1]), numbers(random, many), random.randint(0, 1), zeros(many)]


def call_colour(random: Random) -> list[Any]:
    """Proper arguments of colour."""
    return [numbers(random, random.randint(1, 60)), 10 ** random.uniform(-9, 1), random.randint(0, 6)]


def plain(random: Random) -> list[Any]:
    """A record without anything fitted along."""
    given = record(random)
    return [*given[:3], array("d", [*given[3][:4], *([0.0] * 9)])]


def call_search(random: Random) -> list[Any]:
    """Proper arguments of search."""
    lags, thetas, at, most = (random.randint(0, 3) for _ in range(4))
    at += most
    positive = [array("d", (10 ** random.uniform(-3, 4) for _ in range(k))) for k in (lags, thetas)]
    nodes = lags * thetas
    return [*plain(random), *positive, numbers(random, at), most, zeros(nodes * (most + 1)), zeros(nodes * (most + 1)),
            zeros(nodes * most)]  # fmt: skip


def valves(random: Random, many: int) -> "array[float]":
    """Sticking valves, four numbers each."""
    found = array("d")
    for _ in range(many):
        stick = 10 ** random.uniform(-3, 3)
        found.extend((random.choice((0.0, 1.0)), stick, random.uniform(0, stick), random.uniform(-1, 1)))
    return found


def call_position(random: Random) -> list[Any]:
    """Proper arguments of position."""
    n = random.randint(1, 50)
    return [valves(random, 1), numbers(random, n), zeros(n)]


def call_scan(random: Random) -> list[Any]:
    """Proper arguments of scan."""
    given, many, lags, thetas = plain(random), random.randint(0, 4), random.randint(0, 3), random.randint(0, 3)
    n = len(given[0])
    first, stride = random.randrange(n), random.randint(1, 4)
    rows = (n - first - 1) // stride + 1
    positive = [array("d", (10 ** random.uniform(-3, 4) for _ in range(k))) for k in (lags, thetas)]
    nodes = lags * thetas
    return [*given, valves(random, many), positive[0], array("d", [random.choice((0.0, 2.0)) for _ in range(lags)]),
            positive[1], numbers(random, 3 * lags * rows), numbers(random, lags * rows),
            first, stride, zeros(many * nodes), zeros(many * nodes)]  # fmt: skip


def call_valve_costs(random: Random) -> list[Any]:
    """Proper arguments of valve_costs."""
    given, many = record(random), random.randint(0, 4)
    return [*given, numbers(random, sizes(given)[1]), valves(random, many), zeros(many)]


def call_slip_costs(random: Random) -> list[Any]:
    """Proper arguments of slip_costs."""
    given, each, rows = record(random), array("d"), array("d")
    for _ in range(random.randint(0, 4)):
        own = sorted(random.sample(range(len(given[0])), random.randint(0, min(len(given[0]), 6))))
        each.extend((len(own), random.uniform(-0.3, 1), random.uniform(-9, 9)))
        rows.extend(own)
    return [*given, numbers(random, sizes(given)[1]), each, rows, zeros(2 * len(each) // 3)]


def call_screen(random: Random) -> list[Any]:
    """Proper arguments of screen."""
    n = random.randint(3, 60)
    t = array("d", (10.0 * i for i in range(n)))
    band, shortest = random.choice((0.0, 0.3)), float(random.randint(1, 30))
    return [t, *(numbers(random, n) for _ in range(3)), 50.0, band, shortest, random.randint(1, n), zeros(56)]


def load(random: Random) -> tuple[float, ...]:
    """Degree, roots and what is under them."""
    return (random.randint(1, 3), *(random.choice((1.0, random.random())) for _ in range(3)), -0.9, 0.2, 0.0)


def call_whiten(random: Random) -> list[Any]:
    """Proper arguments of whiten."""
    n, second = random.randint(8, 60), random.choice((0.0, random.random()))
    of = array("d", (random.choice((0.0, 0.3)), second, random.choice((0.0, second))))
    return [numbers(random, n), numbers(random, random.choice((0, n))), array("d", load(random)), of, zeros(7 * n)]


def call_walk(random: Random) -> list[Any]:
    """Proper arguments of walk."""
    n, inputs, loads, deads = random.randint(8, 60), random.randint(0, 5), random.randint(0, 3), random.randint(0, 4)
    walks = array("d", (one for _ in range(loads) for one in load(random)))
    poles = [array("d", [random.random() for _ in range(random.randint(low, 4))]) for low in (1, 0)]
    late = array("d", [random.choice((0.0, 0.5, 3.0, 70.0, random.uniform(0, 90))) for _ in range(deads)])
    tones = random.randint(0, 12)
    ends = array("d", sorted(random.randint(0, tones) for _ in range(random.randint(1, 4))))
    cells = loads * len(ends) * len(poles[0]) * inputs * deads
    of = array("d", (0.9, 0.1, 1e-4, random.choice((0.0, 0.3))))
    return [numbers(random, n), numbers(random, inputs * n), walks, *poles, late, of,
            numbers(random, tones * n), ends, *(zeros(cells) for _ in range(3))]  # fmt: skip


def call_mix(random: Random) -> list[Any]:
    """Proper arguments of mix."""
    loads, rows, deads, many = random.randint(1, 4), random.randint(1, 3), random.randint(1, 3), random.randint(0, 5)
    cells = loads * rows * deads
    positive = [array("d", (10 ** random.uniform(-9, 3) for _ in range(cells))) for _ in range(2)]
    groups = array("d", (float(random.random() < 0.5) for _ in range(loads * random.randint(0, 3))))
    spans = array("d", (float(random.randint(0, many)) for _ in range(2 * rows * deads)))
    return [numbers(random, cells), *positive, array("d", [60.0] * loads), numbers(random, rows * many), groups, spans,
            1.0, rows, zeros(len(groups) // loads * rows * deads * many)]  # fmt: skip


def call_any_load(random: Random) -> list[Any]:
    """Proper arguments of any_load."""
    order, deads, gains = random.randint(1, 31), random.randint(0, 4), random.randint(1, 20)
    n = 2 * order + random.randint(1, 60)
    late = array("d", [random.choice((0.0, 0.5, 3.0, 70.0, random.uniform(0, 90))) for _ in range(deads)])
    spans = array("d", (float(random.randint(0, gains)) for _ in range(2 * deads)))
    lags = array("d", (random.choice((0.5, 0.9, 1.0, 1.1)), 0.1, random.choice((0.0, 0.7)), 1e-3))
    rows = [numbers(random, n), numbers(random, n), late, numbers(random, gains)]
    return [*rows, spans, lags, order, zeros(deads * gains)]


def stepped(random: Random) -> list[Any]:
    """pv, a response, what is there beside the steps, and a share."""
    n, rest = random.randint(2, 50), random.randint(0, 3)
    shares = array("d", (10 ** random.uniform(-9, 0), random.random(), random.choice((-1.0, 0.0, 0.5, 1.0))))
    return [numbers(random, n), numbers(random, n), numbers(random, n * rest), shares]


def call_steps(random: Random) -> list[Any]:
    """Proper arguments of steps."""
    most = random.randint(0, 20)
    return [*stepped(random), zeros(most), zeros(most + 1)]


def call_move_steps(random: Random) -> list[Any]:
    """Proper arguments of move_steps."""
    given = stepped(random)
    rows = array("d", (random.randrange(len(given[0]) - 1) for _ in range(random.randint(0, 6))))
    return [*given, rows, random.randint(0, 15), random.randint(0, 3)]


def call_closed(random: Random) -> list[Any]:
    """Proper arguments of closed."""
    lanes, states, points = random.randint(1, 3), random.randint(1, 4), random.randint(0, 40)
    each = array("d")
    for _ in range(lanes):
        each.extend((*numbers(random, 7), float(random.randint(0, 50)), random.random()))
    return [*(numbers(random, lanes * states * k) for k in (states, 1, 1, 1)), each, 1e12,
            zeros(lanes * points), zeros(lanes * points)]  # fmt: skip


def call_held(random: Random) -> list[Any]:
    """Proper arguments of held."""
    given = [random.uniform(-1, 1) for _ in range(13)] + [float(random.randint(0, 60)), 10.0]
    return [array("d", given), zeros(random.randint(0, 50))]


CALLS: dict[str, Callable[[Random], list[Any]]] = {
    name.removeprefix("call_"): make for name, make in list(globals().items()) if name.startswith("call_")
}


def spoilt(random: Random, value: Any) -> Any:  # noqa: ANN401  anything goes in, anything comes out
    """Something else in the place of an argument."""
    if not isinstance(value, array):
        return random.choice((-1, 0, 2**40, -(2**70), 1e9, float("nan"), float("inf"), None, "x", value))
    kind = random.randrange(8)
    if kind < 4 and len(value):
        changed = array("d", value)
        for _ in range(random.randint(1, 3)):
            changed[random.randrange(len(changed))] = random.choice((*SPECIAL, random.uniform(-1e3, 1e3), 3.0, 0.5))
        return changed
    if kind == 4:
        return array("d", list(value)[: random.randint(0, max(len(value) - 1, 0))])
    if kind == 5:
        return array("d", [*value, *([0.5] * random.randint(1, 9))])
    if kind == 6:
        return random.choice((array("f", value), array("q", [1] * len(value)), b"12345678", None, 3, "text", zeros(0)))
    whole = memoryview(value)
    return random.choice((whole[::2], whole[::-1], whole.toreadonly(), memoryview(bytearray(8 * len(value) + 1))[1:]))


def run(engine: ModuleType, seed: int, calls: int) -> dict[str, int]:
    """Call and count: answered, refused; every door must have answered, or its proper arguments are none any more."""
    random, counts, answered = Random(seed), {"answered": 0, "refused": 0}, set[str]()
    for _ in range(calls):
        name = random.choice(list(CALLS))
        arguments = CALLS[name](random)
        for _ in range(random.choice((0, 1, 1, 1, 2, 4))):
            place = random.randrange(len(arguments))
            arguments[place] = spoilt(random, arguments[place])
        if random.random() < 0.01:
            arguments = arguments[: random.randrange(len(arguments))]
        try:
            getattr(engine, name)(*arguments)
            counts["answered"] += 1
            answered.add(name)
        except (ValueError, TypeError, OverflowError) as error:
            if "\n" in str(error):
                raise RuntimeError("more than one line") from error
            counts["refused"] += 1
    if calls > 100 * len(CALLS) and answered != set(CALLS):
        raise RuntimeError(f"never answered: {', '.join(sorted(set(CALLS) - answered))}")
    return counts


def loaded(path: str | None) -> ModuleType:
    """The extension, from a file of its own if given."""
    if path is None:
        return importlib.import_module("retuner.adaptive.fit._engine")
    spec = importlib.util.spec_from_file_location("_engine", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def sanitized(arguments: list[str]) -> int:
    """Compile with the sanitizers and run this script on the outcome."""
    compiler = shutil.which("gcc")
    if compiler is None:
        sys.stderr.write("no gcc: the sanitizers cannot be used\n")
        return 1
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "_engine.so"
        flags = ["-std=c11", "-O1", "-g", "-ffp-contract=off", "-fsanitize=address,undefined",
                 "-fno-sanitize-recover=all", "-DPy_LIMITED_API=0x030B0000", "-shared", "-fPIC"]  # fmt: skip
        subprocess.run([compiler, *flags, f"-I{sysconfig.get_path('include')}", str(SOURCE), "-o", str(out), "-lm"],
                       check=True)  # fmt: skip
        libraries = [subprocess.run([compiler, f"-print-file-name={name}"], check=True, capture_output=True, text=True)
                     .stdout.strip() for name in ("libasan.so", "libubsan.so")]  # fmt: skip
        environment = os.environ | {"LD_PRELOAD": " ".join(libraries), "ASAN_OPTIONS": "detect_leaks=0"}
        command = [sys.executable, __file__, "--extension", str(out), *arguments]
        return subprocess.run(command, env=environment, check=False).returncode


def main() -> int:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--calls", type=int, default=20000)
    parser.add_argument("--sanitize", action="store_true")
    parser.add_argument("--extension", metavar="FILE", help="another build of the extension")
    options = parser.parse_args()
    if options.sanitize:
        return sanitized(["--seed", str(options.seed), "--calls", str(options.calls)])
    counts = run(loaded(options.extension), options.seed, options.calls)
    sys.stdout.write(", ".join(f"{name} {count}" for name, count in counts.items()) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
