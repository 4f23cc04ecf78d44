# TissueID. `make demo` and `make test` are all that a fresh machine needs; both build .venv when it is missing.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.built

# Linear algebra on one thread: on a busy machine two of them wait for each other, and that can take twenty times as long.
export OPENBLAS_NUM_THREADS ?= 1
# Compiled code is kept, whatever the caller's habit: the tests start hundreds of processes.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help env demo test lint mypy ruff layers compiled translations bench soak firmware conformance docs package bundle run clean

help: ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/' | expand -t 16

env: $(STAMP) ## build the environment in .venv from pinned versions

$(STAMP): pyproject.toml constraints.txt tools/build_env.sh
	@bash tools/build_env.sh $(VENV)

demo: env ## run one guided test on a simulated forearm; leaves demo/report.html
	@$(BIN)/tissueid demo --out demo

test: env ## every check and test
	@$(MAKE) --no-print-directory --jobs 2 mypy compiled layers ruff
	@echo "== tests"
	@QT_QPA_PLATFORM=offscreen $(BIN)/python -m pytest --numprocesses 2 --dist loadfile

lint: ruff mypy layers

ruff: env
	@echo "== ruff"; $(BIN)/ruff check . && $(BIN)/ruff format --check .

mypy: env
	@echo "== mypy"; $(BIN)/mypy

layers: env
	@echo "== layers"; $(BIN)/lint-imports --no-cache

compiled: env # what the tests compile on first use: once, on the processor that the checkers leave free
	@$(BIN)/python tests/compiled_first.py

translations: env ## extract the texts of the program, update the catalogues and compile them
	@$(BIN)/python tools/translations.py

bench: env ## speed, as ratios measured side by side in one run
	@$(BIN)/python -m benchmarks

soak: env ## the long runs: streaming, damaged frames and files, killed hosts, coverage of intervals, long searches
	@$(BIN)/python -m pytest -m soak --timeout 3600 -o addopts="-v -p no:cacheprovider --import-mode=importlib"

firmware: env ## build the reference firmware with the compilers that are installed
	@$(BIN)/python -m firmware_sim.reference.build

conformance: env ## build the reference firmware and test it and the simulator against the protocol
	@$(BIN)/python -m firmware_sim.reference.build
	@$(BIN)/python -m pytest tests/reference -m "soak or not soak" -k "not ten_minutes" -rs --timeout 900 --override-ini addopts="-q -p no:cacheprovider --import-mode=importlib"

docs: env ## build the documentation site: docs/_build/html/index.html
	@$(BIN)/python tools/build_docs.py

package: env ## build wheel and source distribution in dist/
	@$(BIN)/python tools/make_package.py

bundle: env ## build a desktop bundle in dist/: a folder with Python, all packages, icon and launcher
	@$(BIN)/python tools/make_bundle.py

run: env ## open the application
	@$(BIN)/tissueid

clean: ## remove the environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .import_linter_cache .hypothesis build demo dist docs/_build
	find src firmware_sim tests -name __pycache__ -exec rm -rf {} +
