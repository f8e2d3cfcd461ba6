# Each target sets itself up: .venv is made when absent and refreshed when pyproject.toml, constraints.txt or the native sources changed.
PYTHON ?= python3
VENV ?= .venv
PIP_ARGS ?=
# Two pytest processes with one thread each: the tests are many and small, and torch's own threads would contend.
WORKERS ?= 2
PYTEST_ARGS ?=
DEMO_ARGS ?=

# The cross compiler is large, so wheels have an environment of their own: 0.1 GB to download, 0.6 GB laid out.
WHEELS_VENV ?= .venv-wheels
WHEELS ?=
CHECK_ARGS ?=

BIN := $(VENV)/bin
WHEELS_STAMP := $(WHEELS_VENV)/.installed
STAMP := $(VENV)/.installed

.PHONY: help setup demo test lint native-check wheel wheels check-wheels clean
.DEFAULT_GOAL := help

help:
	@echo 'make demo    train, evaluate, export and play the shipped capture (DEMO_ARGS=... is passed on)'
	@echo 'make test    run the tests (WORKERS=2, PYTEST_ARGS="-k registry")'
	@echo 'make lint    ruff check, ruff format --check and mypy'
	@echo 'make native-check  the compiled kernel without warnings, under sanitizers and as 64-bit ARM code'
	@echo 'make wheel   build dist/gavatar-*.whl'
	@echo 'make wheels  build dist/ for Linux, macOS and Windows (WHEELS="win_amd64 any"); brings a compiler of 440 MB'
	@echo 'make check-wheels  what those hold, need and draw (CHECK_ARGS=--install)'
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

$(WHEELS_STAMP): tools/wheels/requirements.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'error: make wheels needs Python 3.11 or later: set PYTHON=python3.11' >&2; exit 2; }
	test -x $(WHEELS_VENV)/bin/python || $(PYTHON) -m venv $(WHEELS_VENV)
	$(WHEELS_VENV)/bin/python -m pip install --disable-pip-version-check --quiet $(PIP_ARGS) -r tools/wheels/requirements.txt
	@touch $@

wheels: $(WHEELS_STAMP)
	$(WHEELS_VENV)/bin/python tools/wheels/build.py $(if $(WHEELS),--only $(WHEELS))

check-wheels: $(WHEELS_STAMP)
	$(WHEELS_VENV)/bin/python tools/wheels/check.py $(CHECK_ARGS)

clean:
	rm -rf build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache $(VENV) $(WHEELS_VENV)
