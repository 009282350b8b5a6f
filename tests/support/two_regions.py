"""The configuration of a quick loop with two regions, both sluggish: a lag of 5 s sampled ten times a second."""

TWO_REGIONS = """
schema = 1
loop = {{ name = "quick", pv_unit = "bar", pv_min = 0.0, pv_max = 10.0, sample_time_s = 0.1 }}
adaptation = {{ mode = "{mode}" }}
[schedule]
variable = "sp"
bounds = [5.0]
hysteresis = 0.2
region = [{{ name = "low", kc = 5.0, tau_i_s = 4.0 }}, {{ name = "high", kc = 20.0, tau_i_s = 4.0 }}]
[device]
kind = "virtual"
seed = 3
[device.plant]
kind = "linear"
k = 0.1
lags_s = [5.0, 0.1]
theta_s = 0.4
start_pv = 2.0
start_co_pct = 30.0
noise = 0.01
[scenario]
duration_s = {duration_s}
steps = [
{steps}
]
[output]
directory = "out"
"""


def two_regions(mode: str, duration_s: float, *steps: str) -> str:
    """As TOML. steps : of the scenario, as TOML has them between braces."""
    lines = ",\n".join(f"    {{ {step} }}" for step in steps)
    return TWO_REGIONS.format(mode=mode, duration_s=duration_s, steps=lines)
