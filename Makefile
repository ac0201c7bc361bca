# The two commands of the README, each from a bare checkout: make reproduce, make test. Neither changes a committed file.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile --constraint constraints.txt

.PHONY: reproduce results test types compiled tests long docs bench baseline clean help

help:
	@echo "make reproduce   reproduce both papers beside TRMM's flight; one page in build/index.html"
	@echo "make results     the same into results/, to be committed"
	@echo "make test        ruff, mypy, import-linter and pytest"
	@echo "make long        the tests of minutes, of which make test runs smaller versions"
	@echo "make docs        the documentation as pages, site/index.html"
	@echo "make baseline    show what moved against results/baseline; gyrocal baseline --write replaces it"
	@echo "make bench       measure the kernel against C, a textbook loop and gtsam; results/benchmarks"
	@echo "make clean       remove the virtual environment and the caches"

reproduce: $(VENV)/run.stamp
	$(BIN)/gyrocal reproduce

results: $(VENV)/run.stamp
	$(BIN)/gyrocal reproduce --out results

test: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(MAKE) --jobs 2 types compiled
	$(MAKE) tests

types: $(VENV)/dev.stamp
	$(BIN)/mypy

compiled: $(VENV)/dev.stamp
	$(BIN)/python -m tests.compiled

tests: $(VENV)/dev.stamp
	$(BIN)/pytest -n 2 --dist worksteal

long: $(VENV)/dev.stamp
	$(BIN)/pytest -n 2 --dist worksteal -m long

docs: $(VENV)/dev.stamp
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet -c docs -d build/doctrees . site
	@echo site/index.html

bench: $(VENV)/dev.stamp
	$(BIN)/python -m benchmarks

baseline: $(VENV)/run.stamp
	$(BIN)/gyrocal baseline

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; set PYTHON=...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/run.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable .
	@touch $@

$(VENV)/dev.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable '.[dev,docs]'
	@touch $@ $(VENV)/run.stamp

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find gyrocal simulator diagnosis studies benchmarks tests -name __pycache__ -type d -exec rm -rf {} +
