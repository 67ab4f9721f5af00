# `make verify` and `make test` are all a newcomer needs; both set up .venv first, and only when something changed.
PYTHON ?= python3
VENV   := .venv
PY     := $(VENV)/bin/python
TOOLS  := $(VENV)/.build-tools
DEPS   := $(VENV)/.dependencies
DEV    := $(VENV)/.development
STAMP  := $(VENV)/.setup
JOBS   ?= auto
# Modules are compiled when they are first imported: most of what is installed never is.
INSTALL = $(PY) -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
KERNEL := $(wildcard lieeuler/_core/*/*)

# Tests and notebooks start some hundred processes, which share the bytecode of what they import.
test test-all test-lieeuler docs: export PYTHONPYCACHEPREFIX := $(CURDIR)/build/bytecode
test test-all test-lieeuler docs: export PYTHONDONTWRITEBYTECODE :=

# Marks of tests/marks.toml: a push runs what is quick and the core of what is slow. `make test MARKS=study` runs studies.
MARKS ?= not slow or core

.PHONY: help ready setup verify smoke sample docs test test-all test-lieeuler sanitize coverage lint benchmark clean

help:
	@echo "make verify     run every method and engine over the scenes, write reports/latest/index.html"
	@echo "make test       run the tests of a push, eight minutes"
	@echo "make test-all   run all tests but the studies"
	@echo "make test-lieeuler  those of lieeuler alone, without crosscheck and engines"
	@echo "make smoke      the main job in half a minute"
	@echo "make sample     a small report of three scenes in reports/sample"
	@echo "make docs       the documents and the API as a site in build/docs"
	@echo "make sanitize   run the kernel's tests under AddressSanitizer and UndefinedBehaviorSanitizer"
	@echo "make coverage   run the tests and print the coverage of Python and C++"
	@echo "make lint       ruff, mypy, codespell, clang-format, the rule of imports"
	@echo "make benchmark  the figures of the page Speed, beside other engines"

# What a run needs. Dependencies are downloaded while the kernel compiles: neither waits for the other.
ready: $(TOOLS)
	@$(MAKE) -s -j2 $(DEPS) $(STAMP)

# What tests, documents and lint need besides, downloaded while the kernel compiles as well.
setup: $(TOOLS)
	@$(MAKE) -s -j2 $(DEV) $(STAMP)

$(TOOLS): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	  || { echo "lieeuler needs Python 3.11 or newer as '$(PYTHON)'; name another with: make PYTHON=python3.12 ..."; exit 1; }
	@command -v $${CXX:-c++} >/dev/null 2>&1 \
	  || { echo "lieeuler needs a C++20 compiler: install one (Debian, Ubuntu: apt-get install g++) and run make again"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo "lieeuler needs Python's venv module: install it (Debian, Ubuntu: apt-get install python3-venv) and run make again"; exit 1; }
	@test -x $(PY) || $(PYTHON) -m venv $(VENV)
	@echo "setting up .venv (a minute or two, once)"
	@$(INSTALL) $$($(PYTHON) tools/requirements.py build)
	@touch $@

$(DEPS): pyproject.toml constraints.txt | $(TOOLS)
	@$(INSTALL) $$($(PYTHON) tools/requirements.py all)
	@touch $@

$(DEV): pyproject.toml constraints.txt | $(DEPS)
	@echo "installing what tests, documents and lint need"
	@$(INSTALL) $$($(PYTHON) tools/requirements.py docs dev)
	@touch $@

# Build tools live in .venv, so that an edit of the kernel needs no fresh isolated environment.
$(STAMP): CMakeLists.txt $(KERNEL) | $(TOOLS)
	@echo "building the kernel"
	@$(PY) -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	@touch $@

# Exit code 3, a run that could not be judged over all of its time, is a finding and no broken run.
verify: ready
	@$(VENV)/bin/crosscheck verify || test $$? -eq 3

smoke: ready
	@$(VENV)/bin/crosscheck verify --profile smoke || test $$? -eq 3

docs: setup
	@$(PY) -m sphinx -q -W --keep-going docs build/docs && echo "documents: build/docs/index.html"

sample: ready
	@$(VENV)/bin/crosscheck verify --profile smoke --scene single_pendulum --scene double_pendulum --scene heavy_top --out reports/sample || test $$? -eq 3

test: setup
	@$(PY) -m pytest -m "$(MARKS)" -n $(JOBS) --dist worksteal $(PYTEST)

test-all:
	@$(MAKE) -s test MARKS="not study"

test-lieeuler: setup
	@$(PY) -m pytest -p no:crosscheck -p tests.lieeuler_alone -m "$(MARKS)" -n $(JOBS) --dist worksteal tests/lieeuler $(PYTEST)

sanitize: setup
	@tools/sanitize

coverage: setup
	@JOBS=$(JOBS) tools/coverage

lint: setup
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/mypy
	@$(VENV)/bin/codespell
	@$(VENV)/bin/clang-format --dry-run -Werror $(filter %.hpp %.cpp,$(KERNEL))
	@$(PY) -m pytest tests/test_rooms.py

benchmark: setup
	@$(PY) -m benchmarks.speed

clean:
	rm -rf $(VENV) build dist lieeuler/_kernel.pyi .pytest_cache .ruff_cache .mypy_cache
