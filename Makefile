# Everything a fresh machine needs: `make demo`, `make test` and, where ROS 2 Jazzy is installed, `make ros`.
# Python 3.11 or newer; PYTHON=/path/to/python chooses another one. Nothing is installed outside .venv.
PYTHON ?= $(shell for p in python3.12 python3.11 python3.13 python3; do command -v $$p >/dev/null 2>&1 && \
	$$p -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
VENV ?= .venv
PY := $(VENV)/bin/python
# Without PYTHONPATH: where ROS is sourced, pip would warn of what ROS brings along.
# Nothing is compiled ahead: of PyTorch and its like most is never imported.
PIP := env -u PYTHONPATH $(PY) -m pip --disable-pip-version-check -qq install --no-compile --constraint constraints.txt
OUT ?= out

.DEFAULT_GOAL := help
.PHONY: help demo tools test lint types unit docs docs-run assets bench fuzz soak licences audit ros clean

help: ## what there is to make
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 12

# -- environments ---------------------------------------------------------------------------------------------

$(VENV)/.created:
	@test -n "$(PYTHON)" || { echo "semloc needs Python 3.11 or newer with venv (Debian: apt install python3-venv)"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	PIP_NO_COMPILE=0 sh tools/install_torch.sh $(PY)  # pip takes this 0 for --no-compile
	@touch $@

$(VENV)/.demo: $(VENV)/.created pyproject.toml constraints.txt
	$(PIP) --editable .
	@touch $@

$(VENV)/.tools: $(VENV)/.created pyproject.toml constraints.txt
	$(PIP) --editable '.[tools,fast]'
	$(PY) -m semloc_core.matching.layout.ready  # compiles once what answers need: half a minute
	@touch $@

$(VENV)/.test: $(VENV)/.tools
	$(PIP) --editable '.[tools,hydra,test]'
	@touch $@

# -- what users run -------------------------------------------------------------------------------------------

demo: $(VENV)/$(if $(DATA),.tools,.demo) ## replay a simulated run (or one through DATA=a Hydra file) against a map; a page in out/demo
	$(PY) -m semloc_core demo $(DATA) --force -o $(OUT)/demo

tools: $(VENV)/.tools ## what the other commands need, beside what the demo does

test: lint types docs unit ## ruff, the order of the rooms, mypy, the site and the whole test suite

lint: $(VENV)/.test
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports --no-cache

types: $(VENV)/.test
	$(VENV)/bin/mypy

unit: $(VENV)/.test
	$(PY) -m pytest -n 2 --dist worksteal -r s

# -- the documentation ------------------------------------------------------------------------------------------

$(VENV)/.docs: $(VENV)/.test
	$(PIP) --editable '.[tools,hydra,test,docs]'
	@touch $@

docs: $(VENV)/.docs ## the site, in out/site; a dead link fails
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs --quiet build --strict --site-dir $(abspath $(OUT))/site

docs-run: $(VENV)/.test ## run the commands of the README and the docs (PAGES=docs/ros.md: of these pages)
	OMP_NUM_THREADS=1 $(PY) tests/docs/docs_run.py $(PAGES)

# -- long ones: speed, and trust --------------------------------------------------------------------------------

$(VENV)/.bench: $(VENV)/.test
	$(PIP) --editable '.[tools,hydra,test,search]'
	@touch $@

bench: $(VENV)/.bench ## speed beside the peers: one table, and figures in out/bench
	@mkdir -p $(OUT)/bench
	OMP_NUM_THREADS=1 $(PY) -m semloc_core bench --force --json $(OUT)/bench/bench.json
	OMP_NUM_THREADS=1 $(PY) -m semloc_core bench update --force --json $(OUT)/bench/update.json -o $(OUT)/bench/update.png
	OMP_NUM_THREADS=1 $(PY) -m semloc_core bench growth --force --json $(OUT)/bench/growth.json --plot $(OUT)/bench/growth.png
	OMP_NUM_THREADS=1 $(PY) -m semloc_core bench fleet --force --json $(OUT)/bench/fleet.json

FUZZ_SECONDS ?= 300
FUZZ_UPDATES ?= 1000000
fuzz: $(VENV)/.test ## damaged files and messages: FUZZ_SECONDS each, a million updates through one localiser
	OMP_NUM_THREADS=1 $(PY) tests/fuzz/fuzz_run.py wire hydra bag map map_graph checkpoint labelspace \
		localiser_filtered --seconds $(FUZZ_SECONDS) --seed $${FUZZ_SEED:-0}
	OMP_NUM_THREADS=1 $(PY) tests/fuzz/fuzz_run.py localiser --count $(FUZZ_UPDATES) --seed $${FUZZ_SEED:-0}

SOAK ?= 300
soak: $(VENV)/.test ## a million updates, a thousand reloads, SOAK kills and SOAK random sequences of updates
	OMP_NUM_THREADS=1 $(PY) tests/soak/soak_run.py
	SEMLOC_SOAK=$(SOAK) $(PY) -m pytest tests/soak tests/stateful tests/map_database/test_map_killed.py \
		tests/fleet/test_fleet_writers.py tests/map_merge/test_merge_killed.py tests/files/test_whole.py \
		tests/test_extremes.py

licences: $(VENV)/.test ## docs/licences.md: what we depend on, in which version, under which licence
	$(PY) tools/licences.py constraints.txt > docs/licences.md

audit: $(VENV)/.test ## known vulnerabilities of the pinned versions, where they can be looked up
	sh tools/audit.sh $(PY)

# -- ROS 2 -----------------------------------------------------------------------------------------------------

$(VENV)/.ros: $(VENV)/.test
	$(PIP) --editable '.[tools,hydra,test,ros,lint]'
	@touch $@

ros: $(VENV)/.ros ## build and test the ROS 2 node (Jazzy, in ROS=/opt/ros/jazzy)
	bash tools/ros.sh $(abspath $(PY))

# -- what the project ships, made again from nothing -------------------------------------------------------------

assets: $(VENV)/.tools ## make the shipped office, model, map and bag again
	sh tools/make_assets.sh $(PY)

clean: ## remove the environment and what was made
	rm -rf $(VENV) $(OUT) build *.egg-info ros2_ws/build ros2_ws/install ros2_ws/log
