"""A setpoint that another loop leads, or a ramp: said once, and after that a few times a day, with a count.

The slave of a cascade completes a response every few samples, and none of them may teach (admission.py). One verdict
said two thousand times a day hides every other row of a ledger. So such a response raises no question any more until
`led_again_s` has passed; it is counted. What else is wrong with a response (telemetry, the sensor, a controller that
acts the wrong way) is said as ever: passed over is only what would be refused for its setpoint.
"""

from dataclasses import replace

from retuner.adaptive.supervision.admission import Admission, Ground, admit, inside_region, setpoint_led
from retuner.adaptive.supervision.pipeline_types import Led, ResponseRecord
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.schedule.table import Lookup


def admitted(record: ResponseRecord, settings: RetunerSettings) -> Admission:
    """Whether a response may teach; the gains of an interpolated table move with it, and the fit allows that."""
    rules = settings.admission
    if record.table.lookup is Lookup.INTERPOLATED or record.crossed:
        rules = replace(rules, changes_most=len(record.samples))
    inside = None if record.crossed else inside_region(record.table.regions, record.region)
    return admit(record.window, record.samples, record.response, rules, inside, settings.pv_range)


def passed_over(led: Led, record: ResponseRecord, settings: RetunerSettings) -> bool:
    """Whether a response says nothing but what was said lately, that the setpoint is led.

    One that ends with the output at a limit is asked: that is how a controller ends that acts the wrong way.
    """
    newest, rules = record.samples[-1], settings.admission
    if newest.t_s - led.said_s >= rules.led_again_s or newest.limited:
        return False
    if not setpoint_led(record.window, record.response, rules):
        return False
    return admitted(record, settings).ground is Ground.SETPOINT_LED


def said(led: Led, record: ResponseRecord, code: str) -> Led:
    """What is kept after a decision of that code on a response."""
    return Led(record.samples[-1].t_s) if code == Ground.SETPOINT_LED.name.lower() else led
