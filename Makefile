# From a bare checkout: `make demo` and `make test`. Both need only Python >= 3.11 with its venv
# module; everything else is installed into .venv, at the versions named in constraints.txt.

# The first of these that is at least 3.11; name another with `make test PYTHON=...`.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo "$$p"; break; }; done)
WORKERS ?= 2
# What the tests and the documentation use.
EXTRAS := app,arrays,cluster,simulate,terrain

VENV := .venv
BIN := $(VENV)/bin
OLDEST := $(VENV)-oldest
RUN := $(VENV)/installed-run
DEV := $(VENV)/installed-dev
# pip reads these for what it installs and for what it needs to build the package itself.
PIP := PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt \
	$(BIN)/python -m pip --disable-pip-version-check install --quiet
RUFF = $(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/zizmor --offline --quiet .github

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo test test-processors test-oldest test-slow verify docs bench benchmark lint format install clean distclean

help:
	@echo 'make demo       friction angle from a measured force history, and a picture in demo-output/'
	@echo 'make test       lint, type-check and test (minutes)'
	@echo 'make test-processors  the numerical tests as on lesser processors (x86 alone)'
	@echo 'make test-oldest  the tests with the oldest versions that pyproject.toml allows'
	@echo 'make test-slow  the checks that take longer'
	@echo 'make verify     problems with known answers, and docs/verification.md (an hour)'
	@echo 'make docs       the documentation, in docs/_build/html/index.html'
	@echo 'make benchmark  angles of other soils, rigs and codes, compared with baselines'
	@echo 'make bench      speed of kernels and inversions, as ratios'
	@echo 'make lint       lint and type-check only'
	@echo 'make format     put the code into the house format'
	@echo 'make clean      remove what the commands above wrote; make distclean removes .venv as well'

demo: $(RUN)
	$(BIN)/terraphi demo --out demo-output

# Neighboring tests share fixtures and compiled kernels: each process begins with a half in order.
# Types are checked at the same time, so that no core waits; what is wrong with them comes last.
# Of pytest's plugins xdist alone is loaded: it would rewrite the assertions in all their modules.
test: $(DEV)
	$(RUFF)
	@$(BIN)/mypy > $(VENV)/mypy.txt 2>&1 & \
	PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 $(BIN)/pytest -p xdist -n $(WORKERS) --dist worksteal; tests=$$?; \
	wait $$!; types=$$?; cat $(VENV)/mypy.txt; exit $$((tests | types))

# The numerical tests as on processors with AVX2 at most, and with neither: Numba and OpenBLAS are
# held to those. Nothing else than x86 knows these names.
NUMERICAL := tests/forward/mpm
test-processors: $(DEV)
	NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES= OPENBLAS_CORETYPE=Haswell \
		$(BIN)/pytest -n $(WORKERS) $(NUMERICAL) tests/laws/test_gp.py
	NUMBA_CPU_NAME=x86-64 NUMBA_CPU_FEATURES= OPENBLAS_CORETYPE=Nehalem \
		$(BIN)/pytest -n $(WORKERS) $(NUMERICAL)

# uv picks the oldest versions; what we do not name ourselves is new, and warns of what is old.
test-oldest:
	"$(PYTHON)" -m venv $(OLDEST)
	$(OLDEST)/bin/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt uv
	$(OLDEST)/bin/uv pip install --quiet --python $(OLDEST)/bin/python --resolution lowest-direct \
		--editable '.[$(EXTRAS),parquet]' --group test
	$(OLDEST)/bin/pytest -n $(WORKERS) -W default --disable-warnings

test-slow: $(DEV)
	$(BIN)/pytest -n $(WORKERS) -m slow

# Whoever changes a solver looks at the page's difference.
verify: $(DEV)
	$(BIN)/pytest -n $(WORKERS) --dist worksteal -m slow verification --page docs/verification.md

# Warnings are errors; nothing is fetched from elsewhere.
docs: $(DEV)
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build/html
	@echo 'Built: docs/_build/html/index.html'

# Fails if a baseline reads other soils, shapes, rigs or codes better than terraphi.
benchmark: $(DEV)
	$(BIN)/python benchmarks/phi_bench.py --check

# Results depend on what else the machine does: the ratios are what to look at.
bench: $(DEV)
	$(BIN)/python benchmarks/bench_kernels.py
	$(BIN)/python benchmarks/bench_inference.py

lint: $(DEV)
	$(RUFF)
	$(BIN)/mypy

format: $(DEV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

install: $(DEV)

$(BIN)/python:
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo 'terraphi needs Python 3.11 or newer, and found none: name one, as in make PYTHON=/path/to/python3.12' >&2; \
		exit 1; }
	"$(PYTHON)" -m venv $(VENV)

$(RUN): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable '.[plot]'
	@touch $@

# What serves the developer serves the demo too.
$(DEV): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --upgrade pip # 25.1 and newer know groups
	$(PIP) --editable '.[$(EXTRAS)]' --group dev
	@touch $(RUN) $@

clean:
	rm -rf build dist demo-output docs/_build docs/auto_notebooks docs/reference/*-keys.md .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find docs/notebooks -mindepth 1 ! -name '*.py' ! -name '*.rst' -delete
	find src tests studies verification benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV) $(OLDEST)
