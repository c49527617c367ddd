# Everything a clone needs: `make demo`, `make test`. See README.md.
PYTHON ?= $(shell for p in python3.11 python3.10 python3; do $$p -c '' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal
AGAIN := $(BIN)/python -m pytest --last-failed --last-failed-no-failures none
DRIVERS := tests/tdpg_deploy/drivers
export OMP_NUM_THREADS ?= 2

.PHONY: setup demo test check lint types clean

setup: .venv/ready

.venv/ready: pyproject.toml constraints.txt tools/preflight.py
	@test -n "$(PYTHON)" || { echo "No Python found. Install Python 3.11: apt install python3.11 python3.11-venv"; exit 1; }
	@$(PYTHON) tools/preflight.py
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check $(PIP_ARGS) -c constraints.txt -e '.[real,audit,eval,train,dev]'
	@touch $@

demo: setup
	$(BIN)/tdpg-run --objects 10 --seed 1 --out logs

# Some tests talk to other processes in real time: what fails is tried once more, alone.
test: lint types
	$(PYTEST) --ignore $(DRIVERS) || $(AGAIN)
	$(PYTEST) $(DRIVERS) --cov --cov-report= || $(AGAIN) --cov --cov-append --cov-report=
	$(BIN)/coverage report

# The quick loop: without slow tests, and without those of wires and calibration.
check: lint types
	$(PYTEST) -m "not slow" $(addprefix --ignore tests/,tdpg_deploy/drivers tdpg_deploy/emulators tdpg_deploy/doctor calibration)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

clean:
	rm -rf .venv build *.egg-info
