"""Whether the device that answers is one that this host may write to."""

from retuner.drivers.codec import schema
from retuner.drivers.frames import PROTOCOL_VERSION, Identity

TOLERANCE = 1e-6  # relative, of the sample time: float32 on the wire


def mismatch(identity: Identity, sample_time_s: float) -> str:
    """What is wrong with who is there, or an empty string; sample_time_s is the one that the host expects."""
    if identity.protocol != PROTOCOL_VERSION:
        return f"it speaks protocol {identity.protocol}, this host {PROTOCOL_VERSION}; update the older of them"
    if identity.schema != schema():
        return f"its frame layout is {identity.schema:#06x}, here {schema():#06x}; use one retuner.dbc on both"
    if abs(identity.sample_time - sample_time_s) > TOLERANCE * sample_time_s:
        return f"its sample time is {identity.sample_time:g} s, configured are {sample_time_s:g} s; make them equal"
    return ""
