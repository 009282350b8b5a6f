"""Small setpoint bumps where days pass without evidence: off until somebody allows them."""
