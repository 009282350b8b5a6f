# The two commands of the README; each does all its set-up. VENV and PYTHON may be overridden.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
DEV    := $(VENV)/.installed-dev

.PHONY: demo test lint bench clean

demo: $(STAMP)  ## set up and run the main job: a virtual oven retuned over CAN, with a report
	$(BIN)/retuner run examples/oven.toml --out runs/demo

test: $(DEV)  ## set up and pass the tests
	$(BIN)/python scripts/link_typing.py
	$(BIN)/python -P -m pytest -q

lint: $(DEV)  ## ruff and mypy --strict
	$(BIN)/python scripts/link_typing.py
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(DEV)  ## speed ratios, measured in one run
	$(BIN)/python benchmarks/per_sample.py

$(STAMP): pyproject.toml setup.py
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "retuner needs Python 3.11 or newer, this is " + sys.version.split()[0] + "; set PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[all]'
	touch $@

$(DEV): $(STAMP)
	$(BIN)/python -m pip install -q --disable-pip-version-check --group test --group lint --group bench build 'setuptools>=77'
	touch $@

clean:
	rm -rf $(VENV) .typing build dist runs *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
