"""The configuration: one TOML file, schema 1. `load_config(path)` gives a `Config` or says what is wrong where."""

from retuner.config.loading import load_config
from retuner.config.model import Config

__all__ = ["Config", "load_config"]
