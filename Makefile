# `make demo` sets up what the demo needs and runs it; `make test` runs the tests that tell most; `make test-all` runs all that CI
# runs, also the slow ones (CONTRIBUTING.md says which).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO_FLAGS ?=

.PHONY: demo test test-all lint types imports unit processes wheel-test libraries clean
.NOTPARALLEL: # tests in real time come alone

demo: $(VENV)/.run-time
	$(BIN)/saltus demo $(DEMO_FLAGS)

test test-all: lint imports unit processes

AND_NOT_SLOW := and not slow
test-all: AND_NOT_SLOW :=

lint: $(VENV)/.development
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.development
	$(BIN)/mypy

imports: $(VENV)/.development
	$(BIN)/lint-imports

# Two workers, each a file at a time in the order of tests/conftest.py. Tests start processes by the
# dozen: the project is compiled once, whatever the environment says. What they leave of the processors goes to mypy, which
# yields to them, but only so far: beside six busy programs a mypy at nice 19 got 11 s of processor time in half an hour.
unit processes: export PYTHONDONTWRITEBYTECODE :=
unit: $(VENV)/.development
	nice -n 5 $(BIN)/mypy & types=$$!; $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder -m 'not realtime $(AND_NOT_SLOW)'; \
	tests=$$?; wait $$types && exit $$tests

# Tests with limits in real time come alone; others need no such peace. First they measure how fast the computer is, and beside
# mypy they took it for half as fast, and twice as long.
processes: $(VENV)/.development
	$(BIN)/pytest -m 'realtime $(AND_NOT_SLOW)' tests/processes

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
	@tools/libraries.sh tests
	$(BIN)/pip install --constraint constraints.txt --editable ".[train,dev]"
	@touch $@

clean:
	rm -rf $(VENV) build dist runs
