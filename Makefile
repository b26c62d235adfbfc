# make run      the main job on planar5_nmp, with everything it needs set up first
# make setup    the virtual environment .venv with flexgen and its tools
# make test     the tests          make lint     format and lint          make types    static types
# make bench    time the emitted C and inverse dynamics against others: benchmarks/peers.md, benchmarks/inversion.md
#               (BENCH=--quick: a first look)
# make golden   write the sources in generated/elbow anew, which a test compares with today's
# make clean    remove what was built (not .venv)
#
# PYTHON=python3.12 make setup    with another interpreter than python3

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: run setup test lint types bench golden clean

run: $(STAMP)
	$(BIN)/python cli.py run planar5_nmp

setup: $(STAMP)

$(STAMP): pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "flexgen: $(PYTHON) is not there; install Python 3.11 or newer, or name one: make PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "flexgen: $$($(PYTHON) --version) is too old, 3.11 or newer is needed: make PYTHON=/path/to/python" >&2; exit 1; }
	@command -v $${CC:-cc} >/dev/null || command -v gcc >/dev/null || command -v clang >/dev/null || echo "flexgen: warning: no C compiler (cc, gcc or clang): C can be written, but not compiled" >&2
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $(STAMP)

# two workers share the cores already: small matrices of many threads wait for each other
test: $(STAMP)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)
	$(BIN)/mypy

bench: $(STAMP)
	$(BIN)/python benchmarks/peers.py $(BENCH)
	$(BIN)/python benchmarks/inversion.py $(BENCH)

golden: $(STAMP)
	$(BIN)/python cli.py generate elbow --no-build --force

clean:
	rm -rf build dist reports *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find generated -mindepth 1 -maxdepth 1 ! -name README.md ! -name elbow -exec rm -rf {} +
	rm -f generated/elbow/*.a generated/elbow/*.so generated/elbow/*.dylib generated/elbow/manifest.json
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -exec rm -rf {} +
