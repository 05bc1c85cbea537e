# `make help` lists the targets. Nothing is needed but Python 3.10 or newer with venv.

ifndef PYTHON
PYTHON := $(shell for p in python3 python3.13 python3.12 python3.11 python3.10 python; do \
	$$p -c 'import sys, venv; sys.exit(sys.version_info < (3, 10))' 2>/dev/null && echo $$p && break; done)
endif
VENV ?= .venv
PORT ?= 5000
BIN := $(VENV)/bin
PY := $(BIN)/python
INSTALLED := $(VENV)/.installed
STORE := $(CURDIR)/mlruns
SLURM := munged slurmctld slurmd sbatch

# One thread a process: at these sizes more threads only get in each other's way.
export OMP_NUM_THREADS := 1
export MLFLOW_DISABLE_TELEMETRY := true

.DEFAULT_GOAL := help
.PHONY: help install demo test test-slow test-faults test-browser test-slurm test-server test-gpu test-commands test-lowest docs ui lint audit smoke bench bench-quick rivals clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

install: $(INSTALLED) ## make the environment in .venv from constraints.txt

$(INSTALLED): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "No Python 3.10 or newer with venv found; give one: make PYTHON=/path/to/python3" >&2; exit 1; }
	@echo "Making the environment $(VENV): one or two minutes, PyTorch is large"
	$(PYTHON) -m venv $(VENV)
	@# modules are compiled when they are first imported, which takes half as long as all at once;
	@# all at once if Python must not write them then, or each start would take ten seconds longer
	$(PY) -m pip install --quiet $(if $(PYTHONDONTWRITEBYTECODE),,--no-compile) \
		--constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: install ## train all four methods on the pendulum and print the results, some minutes
	$(PY) -m symo_exp -cn demo

test: install ## run the tests, except the long ones
	$(PY) -m pytest -n 2 --dist worksteal

test-slow: install ## run the long tests
	$(PY) -m pytest -m slow

test-faults: install ## kill, interrupt and starve runs, and check that nothing is lost; long
	$(PY) -m pytest -m "slow or not slow" tests/faults tests/training tests/runs

test-browser: install ## open the report's page in Chromium (apt-get install chromium chromium-driver)
	$(PY) -m pip install --quiet --constraint constraints.txt --editable '.[browser]'
	$(PY) -m pytest -m browser tests/browser

test-slurm: install ## run sweeps on a SLURM of one node (as root; Debian's packages)
	@which $(SLURM) >/dev/null || [ "$$(id -u)" != 0 ] || ! command -v apt-get >/dev/null || \
		{ apt-get update -qq && apt-get install -y -qq --no-install-recommends slurmctld slurmd slurm-client munge; }
	$(PY) -m pip install --quiet --constraint constraints.txt --editable '.[cluster]'
	$(PY) -m pytest -m slurm tests/clusters

test-server: install ## run eight jobs at once that write through MLflow to PostgreSQL (apt-get install postgresql)
	$(PY) -m pip install --quiet --constraint constraints.txt --editable '.[server]'
	$(PY) -m pytest -m server tests/clusters

test-gpu: install ## train on a GPU and compare the measures with those of the processor
	$(PY) -m pytest -m gpu tests/models tests/training

test-commands: install ## run every command of README, docs and docstrings, in short forms: an hour
	$(PY) -m pytest -m commands tests/test_commands.py

test-lowest: ## run the tests with the lowest versions that pyproject.toml allows, in .venv-lowest
	$(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet uv
	.venv-lowest/bin/uv pip install --quiet --python .venv-lowest/bin/python --resolution lowest-direct --editable '.[dev]'
	.venv-lowest/bin/python -m pytest -n 2 --dist worksteal

docs: install ## build the documentation in build/site, the tutorial run anew
	$(PY) -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	$(PY) -m sphinx --fail-on-warning --keep-going --quiet --conf-dir docs . build/site
	@echo build/site/index.html

ui: install ## open MLflow on the local store (PORT=5000)
	@mkdir -p $(STORE)
	@$(PY) -c "from symo_exp.tracking import page, store; \
		print(*page.pages(store.find(None, '$(STORE)'), 'http://127.0.0.1:$(PORT)'), sep='\n')"
	MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false $(BIN)/mlflow server --workers 1 \
		--host 127.0.0.1 --port $(PORT) \
		--backend-store-uri sqlite:///$(STORE)/mlflow.db \
		--default-artifact-root $(STORE)/artifacts

lint: install ## check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

audit: install ## look up known vulnerabilities of the versions in constraints.txt, on the internet
	$(PY) -m pip install --quiet --constraint constraints.txt --editable '.[audit]'
	$(BIN)/pip-audit --strict --no-deps --disable-pip --requirement constraints.txt

smoke: install ## run a sweep of a few epochs, to check that everything runs
	$(PY) -m symo_exp -cn smoke

bench: install ## measure speed, against other implementations where they are installed
	$(PY) -m benchmarks

bench-quick: install ## measure one system and one batch, in two minutes
	$(PY) -m benchmarks --quick

rivals: ## fit open packages for system identification to the real machines, in .venv-rivals
	$(PYTHON) -m venv .venv-rivals
	grep '^torch==' constraints.txt > .venv-rivals/torch.txt
	.venv-rivals/bin/python -m pip install --quiet --constraint .venv-rivals/torch.txt --editable '.[rivals]'
	.venv-rivals/bin/python -W ignore results/rivals/run.py
	.venv-rivals/bin/python results/rivals/table.py > results/rivals/table.md

clean: ## remove what was built, trained and cached here, and the environment
	rm -rf $(VENV) .venv-lowest .venv-rivals build dist docs/drawn outputs multirun mlruns .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
