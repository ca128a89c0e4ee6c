# Two commands: `make demo` sets up what the demo needs and runs it; `make test` runs what CI runs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO_FLAGS ?=

.PHONY: demo test lint types imports unit wheel-test libraries clean

demo: $(VENV)/.run-time
	$(BIN)/saltus demo $(DEMO_FLAGS)

test: lint types imports unit

lint: $(VENV)/.development
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.development
	$(BIN)/mypy

imports: $(VENV)/.development
	$(BIN)/lint-imports

# Two workers for two cores, in the order of folders: the quick files of tests/saltus come last, so that neither waits
# long for the other's last one. Then, alone, the tests of processes in real time; runs in lockstep need no such peace.
# Tests start processes by the dozen: the project is compiled once, whatever the environment says.
unit: export PYTHONDONTWRITEBYTECODE :=
unit: $(VENV)/.development
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder --ignore tests/processes
	$(BIN)/pytest tests/processes

# A wheel in an empty environment runs the demo from another folder.
wheel-test: libraries
	tools/wheel_test.sh $(PYTHON)

libraries:
	@tools/libraries.sh

$(VENV)/.python: tools/python.sh
	@tools/python.sh $(PYTHON) $(VENV)
	@touch $@

$(VENV)/.run-time: $(VENV)/.python pyproject.toml tools/libraries.sh
	@tools/libraries.sh
	$(BIN)/pip install --editable .
	@touch $@

$(VENV)/.development: $(VENV)/.run-time constraints.txt
	$(BIN)/pip install --constraint constraints.txt --editable ".[train,ray,dev]"
	@touch $@

clean:
	rm -rf $(VENV) build dist runs
