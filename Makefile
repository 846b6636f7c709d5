# Two commands do everything: `make run` drives a robot, `make test` proves it.
# Each sets up what it needs in .venv, from a lock with hashes.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
COMPILE = $(BIN)/pip-compile --quiet --generate-hashes --no-emit-options --allow-unsafe \
	  --strip-extras --no-annotate --no-header
PIP    := $(BIN)/python -m pip --disable-pip-version-check
WORKERS ?= 4
# Where it is set, each of the many processes that tests start compiles every module again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run next tools test test-long test-removal mutants lint docs demo demo-down lock clean
.DEFAULT_GOAL := run

$(VENV)/.run: requirements/run.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Armadico needs Python 3.11 or newer; this is " + sys.version.split()[0] + ". Name another one: make PYTHON=python3.11")'
	@echo "Setting up $(VENV), once: a minute or a few, by the network"
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --require-hashes -r requirements/run.txt
	$(PIP) install --quiet --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.tools: $(VENV)/.run requirements/tools.txt tools/pyproject.toml
	$(PIP) install --require-hashes -r requirements/tools.txt
	$(PIP) install --quiet --no-deps --no-build-isolation -e tools
	@touch $@

$(VENV)/.dev: $(VENV)/.tools requirements/dev.txt
	$(PIP) install --require-hashes -r requirements/dev.txt
	@touch $@

run: $(VENV)/.run  ## set up and drive scenario 4 as separate processes on this machine
	$(BIN)/armadico run sc4
	@$(MAKE) --no-print-directory next

next:  ## what to type after `make run`
	@echo 'To go on, in this shell:'
	@echo '  export PATH="$(abspath $(BIN)):$$PATH"'
	@echo '  armadico run sc4 --virtual --seed 7     # the same society, in a second'
	@echo '  armadico --help                         # everything else; docs/tutorial.md explains'

tools: $(VENV)/.tools  ## the laboratory too: experiments, faults, trials, benchmarks, demos

# Two for each core of the smallest machine: half of its time a test waits for its processes.
test: $(VENV)/.dev  ## set up and run the tests
	@$(BIN)/python -m tests.real_ros
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not long"

test-long: $(VENV)/.dev  ## the long tests: more seeds, scenarios and orders of events
	@$(BIN)/python -m tests.real_ros
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --timeout 300 -m long

test-removal: $(VENV)/.dev  ## take packages out of a copy of the tree: the rest must drive and pass its tests
	$(BIN)/python -m tests.removal -n $(WORKERS)

mutants: $(VENV)/.dev results/mutants.sqlite  ## change what decides in one place at a time, for hours: tests must notice
	$(BIN)/cosmic-ray exec tools/cosmic-ray.toml results/mutants.sqlite
	$(BIN)/cr-report --surviving-only results/mutants.sqlite

results/mutants.sqlite: | $(VENV)/.dev
	$(PIP) install --quiet cosmic-ray==8.7.0
	mkdir -p results
	$(BIN)/cosmic-ray init tools/cosmic-ray.toml $@
	$(BIN)/cr-filter-operators $@ tools/cosmic-ray.toml

lint: $(VENV)/.dev  ## ruff, mypy strict over every package, and the order of the packages
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.dev  ## the documentation as a site: build/site/index.html, from the disk too
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "file://$(abspath build/site/index.html)"

demo: $(VENV)/.tools  ## three hosts as containers: the one that drives is killed, another drives on
	$(BIN)/python -m armadico_tools.hosts.compose $(SCENARIO)

demo-down:  ## what a demo left that was killed
	docker compose --file deploy/compose.yaml down --timeout 1

lock: $(VENV)/.dev  ## write the locks again from pyproject.toml
	for lock in agents:--extra=record run:--extra=plot,record "tools:--extra=plot,record requirements/tools.in" \
	    "cluster:--extra=plot,record requirements/tools.in requirements/cluster.in" \
	    "dev:--extra=plot,record,dashboard,ros2,rivals,docs,dev requirements/tools.in requirements/cluster.in"; do \
	  $(COMPILE) $${lock#*:} -o requirements/$${lock%%:*}.txt pyproject.toml requirements/build.in; \
	done
	$(COMPILE) -o requirements/rclpy.txt requirements/rclpy.in

clean:
	rm -rf $(VENV) build dist *.egg-info runs
