# make        the same as make run
# make help   the list of targets
#
# PYTHON=python3.12 make run    with another interpreter than python3 (3.11 or newer)
# BENCH=--quick make bench      a short benchmark
# PYTEST="-x -k stream" make test    more arguments for pytest

PYTHON ?= python3
WORKERS ?= 2
# From PyPI it comes with CUDA, some gigabytes: PIP_EXTRA_INDEX_URL names a place of builds for the CPU.
TORCH ?= torch==2.13.0
VENV := .venv
BIN := $(VENV)/bin
# Modules are compiled when they are first imported: that halves the time of an installation.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --editable
# The compiled C of the tests. Each entry is named by the hash of what it depends on, so it never has to be removed.
TEST_CACHE := build/test-cache
# Both workers import all modules: they are compiled once, before. Two workers use both cores: more threads in BLAS would
# make them wait for each other.
RUN_TESTS = $(BIN)/python -m compileall -q -j 0 flexgen tests/support && FLEXGEN_TEST_CACHE=$(CURDIR)/$(TEST_CACHE) OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

# Python keeps what it compiles, whatever the environment says: tests and examples start hundreds of processes, and each
# would compile all that it imports again (2 s instead of 0.5 s).
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run help setup setup-test setup-lint setup-dev test test-slow test-kernels test-full test-arrays robots fuzz lint format types docs gallery bench dist sbom golden clean

run: $(VENV)/.installed            ## solve the example planar5_nmp (the default target)
	$(BIN)/python cli.py run planar5_nmp

help:                              ## list the targets
	@sed -n 's/^\([a-z][a-z-]*\):[^#]*##/\1 -/p' Makefile | awk -F ' - ' '{ printf "make %-14s%s\n", $$1, $$2 }'

# --- set-up: one environment; each extra is installed when a target needs it -----------------------------------------
setup: $(VENV)/.installed          ## install flexgen and what it needs to run in .venv
setup-test: $(VENV)/.test          ## also what the tests need
setup-lint: $(VENV)/.lint          ## also ruff and mypy
setup-dev: setup-test setup-lint   ## everything

$(VENV)/.installed: pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "flexgen: $(PYTHON) not found; install Python 3.11 or newer, or name one: make PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "flexgen: $$($(PYTHON) --version) is too old, expected 3.11 or newer: make PYTHON=/path/to/python" >&2; exit 1; }
	@echo "flexgen: installing into $(VENV) (about half a minute)"
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) .
	@command -v $${CC:-cc} >/dev/null || command -v gcc >/dev/null || command -v clang >/dev/null || { \
		echo "flexgen: no C compiler found (cc, gcc or clang): installing the package ziglang, which has one (about 100 MB)"; \
		$(INSTALL) '.[compiler]' || echo "flexgen: warning: no C compiler: C can be written, but not compiled; install the Debian package gcc" >&2; }
	@touch $@

$(VENV)/.test: $(VENV)/.installed
	@echo "flexgen: installing what the tests need (one to three minutes)"
	$(INSTALL) '.[test]'
	@touch $@

$(VENV)/.arrays: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --no-compile $(TORCH)
	@touch $@

$(VENV)/.lint: $(VENV)/.installed
	$(INSTALL) '.[lint]'
	@touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(INSTALL) '.[docs]'
	@touch $@

# --- checks -----------------------------------------------------------------------------------------------------------
test: $(VENV)/.test                ## the quick tests (about 3 minutes on two cores)
	@echo "flexgen: quick tests, about 3 minutes on two cores"
	@$(RUN_TESTS) -m 'not slow and not full and not robots' $(PYTEST)

test-slow: $(VENV)/.test           ## the other tests (about 22 minutes on two cores)
	@echo "flexgen: slow tests, about 22 minutes on two cores"
	@$(RUN_TESTS) -m 'slow and not full and not robots' $(PYTEST)

# OpenBLAS has kernels for each kind of processor, and their last bits differ: with vectors of 128, 256 and 512 bits. The
# last ones need such a processor.
KERNELS := Nehalem Haswell $(if $(shell grep -s -m 1 -o avx512f /proc/cpuinfo),SkylakeX)
OF_NUMBERS := tests/base/test_blas_kernels.py tests/analysis/test_solvability.py tests/analysis/test_zeros.py \
    tests/dynamics/test_structure.py tests/analysis/test_zero_path.py tests/inversion/test_unstable_open_loop.py \
    tests/planning/test_planning.py tests/planning/test_minimum_time.py tests/feedback/test_observers.py tests/identification/test_identify.py \
    tests/identification/test_frequency_responses.py tests/inversion/test_hold.py tests/cross/test_calibration.py tests/cross/test_growth.py \
    tests/published/test_analysis.py

test-kernels: $(VENV)/.test        ## tests of linear algebra with the kernels of other processors (2 minutes)
	@for kernel in $(KERNELS); do \
		echo "flexgen: quick tests of numbers with the kernels $$kernel of OpenBLAS, half a minute"; \
		export OPENBLAS_CORETYPE=$$kernel; \
		$(RUN_TESTS) -m 'not slow and not full and not robots' $(OF_NUMBERS) $(PYTEST) || exit 1; \
	done

test-full: $(VENV)/.test           ## what takes longer still: further robots, large samples, planted errors
	@echo "flexgen: further robots, large random samples and planted errors, more than an hour on two cores"
	@$(RUN_TESTS) -m full $(PYTEST)

test-arrays: $(VENV)/.arrays       ## also the tests of PyTorch (TORCH=..., default torch==2.13.0)
	@echo "flexgen: tests of JAX and PyTorch, about 3 minutes"
	@$(RUN_TESTS) -m 'not full and not robots' tests/cross/test_jax.py tests/cross/test_torch.py $(PYTEST)

robots: $(VENV)/.test              ## 200 moves of elastic robots made from public URDF files
	@echo "flexgen: generated robots, about 80 minutes on an idle core"
	@$(BIN)/python -m pytest -m robots tests/inversion/test_generated_robots.py $(PYTEST)

fuzz: $(VENV)/.test                ## 10,000 mutated files for each reader of files
	@echo "flexgen: mutated files, about 5 minutes on two cores"
	@$(RUN_TESTS) -m fuzz tests/fuzz $(PYTEST)

C_FILES := $(wildcard flexgen/codegen/clib/*.[ch] flexgen/feedback/loop/*.[ch] flexgen/simulation/*/*.c flexgen/feedback/laws/*.c flexgen/feedback/observers/*.c flexgen/backends/autodiff/*.c flexgen/exports/c_code/*/*.[ch] flexgen/exports/fmu/c/*.[ch] examples/*.[ch] examples/motion_control/*.h examples/motion_control/*/*.h benchmarks/*.[ch] tests/support/*.[ch] tests/support/*/*.[ch])

lint: $(VENV)/.lint                ## check format and style
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/clang-format --dry-run -Werror $(C_FILES)

format: $(VENV)/.lint              ## write the format and the fixes of ruff
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(C_FILES)

types: $(VENV)/.lint               ## check the static types
	$(BIN)/mypy

# --- documentation ----------------------------------------------------------------------------------------------------
docs: $(VENV)/.docs                ## build the site: build/docs/index.html, with the gallery where it was built
	$(BIN)/python docs/build_site.py build/docs

gallery: $(VENV)/.installed        ## run all scripts of the gallery: build/gallery/index.html, two minutes
	$(BIN)/python examples/gallery/build.py build/gallery

# --- others -----------------------------------------------------------------------------------------------------------
bench: $(VENV)/.test               ## time C and inverse dynamics against others: benchmarks/*.md (BENCH=--quick)
	@echo "flexgen: benchmarks, more than an hour; BENCH=--quick takes some minutes"
	$(BIN)/python benchmarks/peers.py $(BENCH)
	$(BIN)/python benchmarks/inversion.py $(BENCH)
	$(BIN)/python benchmarks/control.py $(BENCH)

dist: $(VENV)/.test                ## write sdist, wheel and recipe.yaml for conda to dist/; same sources, same bytes
	$(BIN)/python .ci/dist.py dist
	$(BIN)/python .ci/conda.py dist

sbom: $(VENV)/.installed           ## write the bill of materials dist/sbom.cdx.json: what running needs, CycloneDX
	$(BIN)/python .ci/sbom.py dist/sbom.cdx.json

golden: $(VENV)/.installed         ## write generated/elbow, the stub and tests/golden again; tests compare them
	$(BIN)/python tests/golden/update.py

clean:                             ## remove what was built (not .venv)
	rm -rf build dist reports *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find generated -mindepth 1 -maxdepth 1 ! -name README.md ! -name elbow -exec rm -rf {} +
	rm -f generated/elbow/*.a generated/elbow/*.so generated/elbow/*.dylib generated/elbow/manifest.json
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -exec rm -rf {} +
