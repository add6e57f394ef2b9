# What a newcomer types. Each target sets up what it needs in .venv, once, and again only after
# pyproject.toml or constraints.txt has changed. Nothing but Python 3.11 or later is needed before.

VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2
OUT ?= runs/demo
RUNS ?= 1000000
CHAOS ?= 10000
HOURS ?= 24
ARGS ?=

SETTINGS := pyproject.toml constraints.txt
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --quiet

.DEFAULT_GOAL := help
.PHONY: help demo setup test test-all commands fuzz chaos soak lint docs figures format scenario-keys \
	readme-picture view-pictures clean

help:
	@echo "make demo      four robots map a cliff over thin radios; ends with a picture of it"
	@echo "make test      the tests, without the slow ones"
	@echo "make test-all  all tests"
	@echo "make commands  every command of the documents, in processes as a reader runs them"
	@echo "make fuzz      a million damaged and forged inputs for each decoder (RUNS=n)"
	@echo "make chaos     10,000 small runs under random faults (CHAOS=n), half of them with tethers"
	@echo "make soak      24 simulated hours under faults, in which no process may grow (HOURS=n)"
	@echo "make lint      ruff, pyright (strict), and the import contract of the four rooms"
	@echo "make docs      the documents as a site, in build/site, with strict links"
	@echo "make setup     only set up $(VENV), with $(BIN)/ropeteam in it"
	@echo "make clean     remove $(VENV) and what tools left behind; runs/ stays"

demo: $(VENV)/run.stamp
	@$(BIN)/ropeteam run cliff --out "$(OUT)" --overwrite $(ARGS)
	@echo "Picture: $(OUT)/overview.png"

setup: $(VENV)/run.stamp
	@echo "Ready: $(BIN)/ropeteam --help"

# Kernels are compiled before the tests start, or each worker would compile them for itself.
test: $(VENV)/test.stamp
	@$(BIN)/python -m scenarios.compiling
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not slow" $(ARGS)

test-all: $(VENV)/test.stamp
	@$(BIN)/python -m scenarios.compiling
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal $(ARGS)

commands: $(VENV)/test.stamp
	@$(BIN)/python -m scenarios.compiling
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m slow tests/test_docs_commands.py $(ARGS)

fuzz: $(VENV)/fuzz.stamp
	$(BIN)/python fuzz/run.py --runs $(RUNS) $(ARGS)

chaos: $(VENV)/run.stamp
	@$(BIN)/python -m scenarios.compiling
	$(BIN)/ropeteam chaos pair --small --runs $$(($(CHAOS) / 2)) --jobs $(JOBS) \
		--out runs/chaos-pair.json $(ARGS)
	$(BIN)/ropeteam chaos cliff --small --runs $$(($(CHAOS) / 2)) --jobs $(JOBS) \
		--out runs/chaos-cliff.json $(ARGS)

soak: $(VENV)/run.stamp
	@$(BIN)/python -m scenarios.compiling
	$(BIN)/ropeteam soak --hours $(HOURS) --out runs/soak.json $(ARGS)

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

format: $(VENV)/dev.stamp
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

# Writes the tables of docs/scenarios.md anew from the settings themselves.
docs: $(VENV)/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

figures: $(VENV)/run.stamp
	$(BIN)/python docs/figures.py

scenario-keys: $(VENV)/run.stamp
	$(BIN)/python docs/scenario_keys.py
	$(BIN)/python docs/schemas.py

readme-picture: demo
	cp "$(OUT)/overview.png" docs/images/cliff.png

# Two runs of minutes; needs Chromium.
view-pictures: demo
	$(BIN)/ropeteam run cliff --set links.profile=sojourner --out runs/thin --overwrite --quiet
	$(BIN)/python docs/view_pictures.py runs/demo runs/thin

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache .hypothesis .import_linter_cache

# --- setting up -----------------------------------------------------------------------------------

$(VENV)/run.stamp: EXTRAS :=
$(VENV)/test.stamp: EXTRAS := [test]
$(VENV)/dev.stamp: EXTRAS := [test,dev]
$(VENV)/fuzz.stamp: EXTRAS := [test,fuzz]
$(VENV)/docs.stamp: EXTRAS := [docs]

# The build tool is pinned like all else, hence no build isolation.
$(VENV)/%.stamp: $(SETTINGS)
	@echo "Setting up $(VENV) (under a minute, once) ..."
	@$(FIND_PYTHON); $(BIN)/python -m pip --version >/dev/null 2>&1 || "$$found" -m venv $(VENV)
	@$(PIP) -c constraints.txt setuptools
	@$(PIP) -c constraints.txt --no-build-isolation -e ".$(EXTRAS)"
	@touch $@

# Prints nothing where it finds one; the first of these that is new enough counts.
PYTHON ?= python3 python3.11 python3.12 python3.13
define FIND_PYTHON
found=""; for p in $(PYTHON); do \
	if "$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; \
	then found="$$p"; break; fi; done; \
if [ -z "$$found" ]; then \
	echo "ropeteam needs Python 3.11 or later; tried: $(PYTHON). Name one: make PYTHON=/path/to/python" >&2; \
	exit 1; fi
endef
