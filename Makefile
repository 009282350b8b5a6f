# The two commands of the README, `make demo` and `make test`; each does all its set-up. PYTHON and VENV may be set.
PYTHON ?= python3
VENV   ?= .venv
PYTEST ?=
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
TESTS  := $(VENV)/.installed-test
DEV    := $(VENV)/.installed-dev
unexport PYTHONDONTWRITEBYTECODE # every process would compile all that it imports: five seconds for `retuner run`
PIP    := $(BIN)/python -m pip install --no-compile --disable-pip-version-check

.PHONY: demo test coverage lint docs lowest release bench nightly clean

demo: $(STAMP)  ## set up and run the main job: a virtual oven retuned over CAN, with a report
	$(BIN)/retuner run examples/oven.toml --out runs/demo --serve

test: $(TESTS)  ## set up and pass the tests, on all cores; PYTEST='-k pid' and the like are handed on
	$(BIN)/python scripts/link_typing.py
	$(BIN)/python -P -m pytest -q -n auto --maxprocesses 4 --dist worksteal $(PYTEST)

COVERED := 95 # percent of lines and branches
coverage: $(DEV)  ## all tests at the effort of CI with the lines and branches that they run; half an hour
	$(BIN)/python scripts/link_typing.py
	RETUNER_TESTS=ci $(BIN)/python -P -m pytest -q -n auto --maxprocesses 4 --dist worksteal \
	    --cov --cov-report=term:skip-covered --cov-fail-under=$(COVERED) $(PYTEST)

lint: $(DEV)  ## ruff and mypy --strict
	$(BIN)/python scripts/link_typing.py
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(DEV)  ## the documentation site, into build/site: open build/site/index.html
	$(BIN)/python -P -m sphinx -W --keep-going -q -b html docs build/site

lowest:  ## the demo and a fast part of the tests with the lowest versions that pyproject.toml allows
	$(PYTHON) scripts/lowest_versions.py

release: $(DEV)  ## archives in dist/, tried in clean environments of every Python that is found, with an SBOM
	$(BIN)/python scripts/release.py

bench: $(DEV)  ## speed ratios, measured in one run
	$(BIN)/python benchmarks/startup.py
	$(BIN)/python benchmarks/per_sample.py

nightly: $(DEV)  ## the long runs behind docs/developers/safety.md and docs/developers/simulation.md; hours
	scripts/nightly

# The stamp is taken away while something is being installed, so an environment without one is half-installed (or not
# ours to trust) and is made anew. pip 25.1 is the first that knows the dependency groups of pyproject.toml.
$(STAMP): pyproject.toml setup.py
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "retuner needs Python 3.11 or newer, and $(PYTHON) is " + sys.version.split()[0] + "; say which with: make PYTHON=python3.11")'
	@test -f $@ && $(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@rm -f $@ $(TESTS) $(DEV)
	@echo "installing retuner and what it needs into $(VENV): a minute or two, once"
	@$(PIP) -q --upgrade 'pip>=25.1'
	@$(PIP) -e '.[all]'
	@echo "installed"
	@touch $@

$(TESTS): $(STAMP)
	@rm -f $(STAMP)
	@echo "installing what tests need into $(VENV): half a minute, once"
	@$(PIP) -q --group test
	@touch $(STAMP) $@

$(DEV): $(STAMP)
	@rm -f $(STAMP)
	@echo "installing what tests, lint and docs need into $(VENV): a minute or two, once"
	@$(PIP) --group test --group lint --group bench --group docs build 'setuptools>=77'
	@touch $(STAMP) $(TESTS) $@

clean:  ## take away everything that the commands above made
	rm -rf $(VENV) .venv-lowest .typing build dist runs *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage
