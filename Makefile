# Each target sets itself up: .venv is made when absent and refreshed when pyproject.toml, constraints.txt or the native sources changed.
PYTHON ?= python3
VENV ?= .venv
PIP_ARGS ?=
# Two pytest processes with one thread each: the tests are many and small, and torch's own threads would contend.
WORKERS ?= 2
PYTEST_ARGS ?=
DEMO_ARGS ?=

BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: help setup demo test lint native-check wheel clean
.DEFAULT_GOAL := help

help:
	@echo 'make demo    train, evaluate, export and play the shipped capture (DEMO_ARGS=... is passed on)'
	@echo 'make test    run the tests (WORKERS=2, PYTEST_ARGS="-k registry")'
	@echo 'make lint    ruff check, ruff format --check and mypy'
	@echo 'make native-check  the compiled kernel without warnings, under sanitizers and as 64-bit ARM code'
	@echo 'make wheel   build dist/gavatar-*.whl'
	@echo 'make setup   only make the environment $(VENV)'
	@echo 'make clean   remove build outputs and $(VENV)'
	@echo 'PYTHON=python3.12 picks the interpreter (3.11 or later), PIP_ARGS=... is handed to pip'

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt $(wildcard setup.py deploy/native/*) \
    deploy/gavatar_runtime/splatting_rule.py
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'error: constraints.txt needs Python 3.11 or later: set PYTHON=python3.11' >&2; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet $(PIP_ARGS) -c constraints.txt -e '.[train,dev]'
	@touch $@

demo: $(STAMP)
	$(BIN)/gavatar-demo $(DEMO_ARGS)

test: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(PYTEST_ARGS)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m mypy

native-check: $(STAMP)
	PYTHON=$(BIN)/python tools/native_warnings.sh
	PYTHON=$(BIN)/python tools/native_sanitize.sh
	PYTHON=$(BIN)/python tools/native_neon.sh

wheel: $(STAMP)
	$(BIN)/python -m build --wheel --no-isolation .

clean:
	rm -rf build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache $(VENV)
