# Set-up and the two commands a newcomer needs; everything lives in $(VENV).
# Debian 12 with git, make, python3 and python3-venv is enough.

VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin
INSTALL := $(BIN)/uv pip install --quiet --python $(BIN)/python -c constraints.txt -b constraints.txt
PYTEST_ARGS ?= -n 2 --dist loadfile

# Every server that a test starts would compile every module again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test lint types browser clean
.DEFAULT_GOAL := help

help: ## Say what there is
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## (.*)/make \1\t\2/' | expand -t 16

demo: $(VENV)/.base ## A simulated warehouse with thirty phones; prints the link of the live page
	@$(BIN)/pharos demo

# The engine's kernels are compiled here once, not by each process that a test starts.
test: $(VENV)/.dev lint types browser ## Everything that continuous integration runs
	$(BIN)/python -c 'from app.core.engine import warm_up; warm_up()'
	$(BIN)/pytest $(PYTEST_ARGS)

lint: $(VENV)/.dev ## Style, formatting and the import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/.dev ## Strict typing
	$(BIN)/mypy --strict app

# Where we may install packages, get the browser that the browser tests drive; elsewhere they skip.
browser:
	@command -v chromium >/dev/null || [ "$$(id -u)" != 0 ] || ! command -v apt-get >/dev/null || \
	{ apt-get update -qq && \
	  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium; } \
	  >/dev/null || echo "chromium could not be installed: browser tests will skip"

clean: ## Remove the virtual environment and every cache
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find app tests benchmarks migrations -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.uv: constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Pharos needs Python 3.11 or newer: make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt uv
	@touch $@

$(VENV)/.base: $(VENV)/.uv pyproject.toml constraints.txt
	$(INSTALL) -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.uv pyproject.toml constraints.txt
	$(INSTALL) -e '.[dev,postgres]'
	@touch $(VENV)/.base $@
