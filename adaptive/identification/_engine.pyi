from typing_extensions import Buffer

version: str

def refine(
    t: Buffer,
    pv: Buffer,
    co: Buffer,
    numbers: Buffer,
    p: Buffer,
    low: Buffer,
    high: Buffer,
    stride: Buffer,
    root: Buffer,
    target: Buffer,
    explained: Buffer,
    evaluations: int,
    enough: float,
    /,
) -> float: ...
def costs(t: Buffer, pv: Buffer, co: Buffer, numbers: Buffer, points: Buffer, out: Buffer, /) -> None: ...
def project(
    t: Buffer,
    pv: Buffer,
    co: Buffer,
    numbers: Buffer,
    p: Buffer,
    q: Buffer,
    r: Buffer,
    c: Buffer,
    moved: Buffer,
    columns: Buffer,
    triangle: Buffer,
    /,
) -> None: ...
def jacobian(t: Buffer, pv: Buffer, co: Buffer, numbers: Buffer, p: Buffer, out: Buffer, /) -> None: ...
def gains(t: Buffer, pv: Buffer, co: Buffer, numbers: Buffer, p: Buffer, instants: Buffer, out: Buffer, /) -> None: ...
def colour(r: Buffer, least: float, most_order: int, /) -> tuple[float, tuple[float, ...]]: ...
def search(
    t: Buffer,
    pv: Buffer,
    co: Buffer,
    numbers: Buffer,
    lags: Buffer,
    thetas: Buffer,
    at: Buffer,
    most: int,
    deviance: Buffer,
    slope: Buffer,
    chosen: Buffer,
    /,
) -> None: ...
def position(valve: Buffer, co: Buffer, out: Buffer, /) -> None: ...
def scan(
    t: Buffer,
    pv: Buffer,
    co: Buffer,
    numbers: Buffer,
    valves: Buffer,
    lags: Buffer,
    thetas: Buffer,
    q: Buffer,
    y: Buffer,
    first: int,
    stride: int,
    left: Buffer,
    gain: Buffer,
    /,
) -> None: ...
def valve_costs(
    t: Buffer, pv: Buffer, co: Buffer, numbers: Buffer, p: Buffer, valves: Buffer, out: Buffer, /
) -> None: ...
