# Desire Path. `make run` opens the product with a demo study; `make check` answers in minutes, `make test` checks everything.
SHELL := /bin/bash
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
# Whole files go to a process, long ones first. Of all tests, browsers, servers and films let a core rest for a third of their
# time: a process more than there are cores fills it. The fast ones compute all the time.
TEST_PROCESSES ?= $(shell echo $$(($$(nproc) + 1)))
EXTRAS := postgres s3 reference openid recordings docs dev
# Tests start hundreds of Pythons, each of which would compile the product's modules anew.
unexport PYTHONDONTWRITEBYTECODE
SIDE_BY_SIDE = --dist loadfile -n

.PHONY: compose-here rehearse-upgrade run check test-fast test test-all setup setup-test compiled lint lock secrets docs results clean

run: setup
	$(BIN)/desirepath serve --demo

# Lint and the tests without servers, browsers and trainings (tests/conftest.py says which), side by side.
check: setup $(VENV)/.tools-ready node_modules/.ready
	$(MAKE) -j 2 --output-sync=target lint test-fast

test-fast: setup $(VENV)/.tools-ready
	$(BIN)/python -m pytest -q -m fast $(SIDE_BY_SIDE) $(shell nproc)

# Lint beside the tests, which leave room for it at their beginning; `make check` says first what it finds.
test: setup node_modules/.ready
	$(MAKE) -j 2 --output-sync=target setup-test compiled
	$(MAKE) -j 2 lint test-all

test-all: setup
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) $(TEST_PROCESSES) --no-loadscope-reorder --durations=50

# What Numba compiles once and keeps on disk, else every process of the tests would compile it at the same time.
compiled: setup
	$(BIN)/python -c 'from desirepath.jobs.run import load; load()'

lint: setup node_modules/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m desirepath.web.core.published
	node_modules/.bin/tsc -p .
	node_modules/.bin/tsc -p tsconfig.stage.json

setup: $(VENV)/.ready

$(VENV)/.ready: requirements.lock pyproject.toml experiments/pyproject.toml scripts/setup.sh
	PYTHON="$(PYTHON)" scripts/setup.sh
	@touch $@

node_modules/.ready: package.json scripts/setup_node.sh scripts/browser_modules.mjs
	scripts/setup_node.sh
	@touch $@

setup-test: setup $(VENV)/.tools-ready
	scripts/setup_chromium.sh

$(VENV)/.tools-ready: $(VENV)/.ready scripts/tools.lock scripts/setup_tools.sh
	scripts/setup_tools.sh
	@touch $@

# Resolve pyproject.toml anew. torch stays outside: its CPU build differs by machine; ROS comes to the tools' environment.
lock:
	printf 'torch ; python_version < "3"\n' > $(VENV)/without-torch.txt
	$(BIN)/python -m uv pip compile pyproject.toml $(EXTRAS:%=--extra %) --override $(VENV)/without-torch.txt \
	  --generate-hashes --python-version 3.11 --no-header --no-annotate -q -o requirements.lock
	$(BIN)/python -m uv pip compile scripts/tools.in pyproject.toml --extra ros -c requirements.lock --override $(VENV)/without-torch.txt \
	  --generate-hashes --python-version 3.11 --no-header --no-annotate -q -o scripts/tools.lock \
	  $$(sed -n 's/^\([A-Za-z0-9._-]*\).*==.*/--no-emit-package \1/p' requirements.lock)

# The manual as a site in site/, which fetches nothing from elsewhere; the lab shows the same pages without being built.
docs: setup
	$(BIN)/python -m desirepath_experiments.manual
	$(BIN)/zensical build --clean --strict

# The manual's page of results, from experiments/results.
results: setup
	$(BIN)/python -m desirepath_experiments.manual results

# What docker-compose.yml needs before its first start; what is there stays.
secrets:
	mkdir -p -m 700 secrets
	test -s secrets/database_password || (umask 022 && od -An -N24 -tx1 /dev/urandom | tr -d ' \n' > secrets/database_password)

# What docker-compose.yml would start, without containers, on loopback; a study walked through it in Chromium.
compose-here: setup-test
	$(BIN)/python -m tests.composed walk

# The version of a commit (OLD=...), upgraded to this one while people take part: what was lost?
rehearse-upgrade: setup-test
	$(BIN)/python -m tests.composed upgrade $(if $(OLD),--old $(OLD)) --participants 4

clean:
	rm -rf $(VENV) site .venv-tools node_modules frontend/static/npm .pytest_cache .mypy_cache .ruff_cache
