"""The templates of docs/templates, loaded as the modules that a contributor makes of them."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "templates"


def template(name: str) -> ModuleType:
    """The module in docs/templates of this name."""
    spec = spec_from_file_location(f"template_{name}", FOLDER / f"{name}.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
