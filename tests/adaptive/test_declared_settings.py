"""Settings are held to their declaration: a value outside its range, or no number, is refused by its name."""

import math
import pkgutil
from dataclasses import is_dataclass
from importlib import import_module

import pytest

from retuner import adaptive
from retuner.adaptive.declared_setting import declared
from retuner.drivers import plants

ROOMS = ((adaptive.__path__, "retuner.adaptive."), (plants.__path__, "retuner.drivers.plants."))
MODULES = [import_module(found.name) for path, name in ROOMS for found in pkgutil.walk_packages(path, name)]
SETTINGS = [
    kind
    for module in MODULES
    for kind in vars(module).values()
    if isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == module.__name__ and declared(kind)
]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda kind: kind.__name__)
def test_a_setting_outside_its_range_is_refused_by_its_name(settings: type) -> None:
    for name, _, _, setting in declared(settings):
        ends = [setting.low - 1, setting.high + 1, *([setting.low] if setting.positive else [])]
        for wrong in (math.nan, *filter(math.isfinite, ends)):
            with pytest.raises(ValueError, match=f"{name} = "):
                settings(**{name: wrong})
