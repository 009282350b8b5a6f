from array import array

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64] | array[float]

version: str

def refine(
    t: Numbers,
    pv: Numbers,
    co: Numbers,
    numbers: Numbers,
    p: Numbers,
    low: Numbers,
    high: Numbers,
    stride: Numbers,
    root: Numbers,
    target: Numbers,
    explained: Numbers,
    evaluations: int,
    enough: float,
    /,
) -> float: ...
def costs(t: Numbers, pv: Numbers, co: Numbers, numbers: Numbers, points: Numbers, out: Numbers, /) -> None: ...
def project(
    t: Numbers,
    pv: Numbers,
    co: Numbers,
    numbers: Numbers,
    p: Numbers,
    q: Numbers,
    r: Numbers,
    c: Numbers,
    moved: Numbers,
    columns: Numbers,
    triangle: Numbers,
    /,
) -> None: ...
def jacobian(t: Numbers, pv: Numbers, co: Numbers, numbers: Numbers, p: Numbers, out: Numbers, /) -> None: ...
def gains(
    t: Numbers, pv: Numbers, co: Numbers, numbers: Numbers, p: Numbers, instants: Numbers, corner: int, out: Numbers, /
) -> None: ...
def colour(r: Numbers, least: float, most_order: int, /) -> tuple[float, tuple[float, ...]]: ...
def search(
    t: Numbers,
    pv: Numbers,
    co: Numbers,
    numbers: Numbers,
    lags: Numbers,
    thetas: Numbers,
    at: Numbers,
    most: int,
    deviance: Numbers,
    slope: Numbers,
    chosen: Numbers,
    /,
) -> None: ...
def position(valve: Numbers, co: Numbers, out: Numbers, /) -> None: ...
def scan(
    t: Numbers,
    pv: Numbers,
    co: Numbers,
    numbers: Numbers,
    valves: Numbers,
    lags: Numbers,
    seconds: Numbers,
    thetas: Numbers,
    q: Numbers,
    y: Numbers,
    first: int,
    stride: int,
    left: Numbers,
    gain: Numbers,
    /,
) -> None: ...
def valve_costs(
    t: Numbers, pv: Numbers, co: Numbers, numbers: Numbers, p: Numbers, valves: Numbers, out: Numbers, /
) -> None: ...
def slip_costs(
    t: Numbers, pv: Numbers, co: Numbers, numbers: Numbers, p: Numbers, slips: Numbers, rows: Numbers, out: Numbers, /
) -> None: ...
def screen(
    t: Numbers,
    sp: Numbers,
    pv: Numbers,
    co: Numbers,
    longest: float,
    band: float,
    shortest: float,
    width: int,
    out: Numbers,
    /,
) -> None: ...
def walk(
    pv: Numbers,
    inputs: Numbers,
    loads: Numbers,
    seconds: Numbers,
    falls: Numbers,
    deads: Numbers,
    numbers: Numbers,
    tones: Numbers,
    ends: Numbers,
    gain: Numbers,
    information: Numbers,
    left: Numbers,
    /,
) -> None: ...
def whiten(pv: Numbers, inputs: Numbers, load: Numbers, numbers: Numbers, out: Numbers, /) -> int: ...
def mix(
    gain: Numbers,
    information: Numbers,
    left: Numbers,
    half: Numbers,
    gains: Numbers,
    groups: Numbers,
    spans: Numbers,
    size: float,
    rows: int,
    out: Numbers,
    /,
) -> None: ...
def any_load(
    pv: Numbers,
    co: Numbers,
    deads: Numbers,
    gains: Numbers,
    spans: Numbers,
    numbers: Numbers,
    order: int,
    left: Numbers,
    /,
) -> None: ...
def steps(pv: Numbers, response: Numbers, rest: Numbers, numbers: Numbers, rows: Numbers, left: Numbers, /) -> int: ...
def move_steps(
    pv: Numbers, response: Numbers, rest: Numbers, numbers: Numbers, rows: Numbers, reach: int, passes: int, /
) -> float: ...
def closed(
    phi: Numbers, gamma: Numbers, c: Numbers, x: Numbers, numbers: Numbers, most: float, e: Numbers, u: Numbers, /
) -> None: ...
def held(numbers: Numbers, pv: Numbers, /) -> int: ...
