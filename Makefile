# survey-sim: `make` installs and runs the demo, `make test` installs and runs the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?=

.DEFAULT_GOAL := demo
.PHONY: demo test lint bench soak mutation docs catalogues survey system clean help

demo: $(VENV)/.installed  ## install, and run pipelines/demo.toml into runs/demo (the default)
	$(BIN)/survey-sim run pipelines/demo.toml $(if $(WORKERS),--workers $(WORKERS))

test: lint  ## install what the tests need, and run them: a process a core, each test file in one
	$(BIN)/pytest --numprocesses logical --dist loadfile

lint: $(VENV)/.dev  ## style, types and the rooms' import directions
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.dev  ## benchmarks of kernels and stages, as ratios to a yardstick of the same run
	$(BIN)/pytest tests/benchmarks --benchmark-only --benchmark-timer=time.process_time --benchmark-columns=min,median,rounds

soak: $(VENV)/.dev  ## 100 kills, 100,000 hard fields, millions of rows, fuzz with many examples: hours
	$(BIN)/pytest -s tests/soaks/soak_*.py
	SOAK_EXAMPLES=5000 $(BIN)/pytest tests/test_fuzz.py

mutation: $(VENV)/.dev  ## break our own code in small ways, one at a time: which of them do the tests not notice?
	$(BIN)/python -m tests.mutate

docs: $(VENV)/.docs  ## build the pages of docs/ into site/, and docs/data-model.md from the schema
	$(BIN)/python -m survey_sim.survey.docs docs
	$(BIN)/python docs/figures.py docs/made
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going docs site
	@echo "look at site/index.html"

catalogues: $(VENV)/.installed  ## make the mock catalogues in the cache, and check all cards
	$(BIN)/survey-sim catalogue make taipan-mock
	$(BIN)/survey-sim catalogue list

survey: $(VENV)/.installed  ## run pipelines/five-year.toml: both surveys, five years, in some tens of minutes
	$(BIN)/survey-sim run pipelines/five-year.toml $(if $(WORKERS),--workers $(WORKERS))

system:  ## Debian packages that tests with other programs need (as root); without them those tests are skipped
	apt-get update -qq
	apt-get install -y -qq --no-install-recommends stilts chromium chromium-driver

help:  ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

clean:  ## remove the environment, runs and caches
	rm -rf $(VENV) runs site docs/made .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit("survey-sim needs Python 3.11 or later" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	$(BIN)/python -m survey_sim.survey.warm
	touch $@

$(VENV)/.dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@
