# make demo        set up, run the demo scene through the Blender add-on, print the table
# make test        lint, types, tests
# make test-long   the slow tests
# make test-blender  the add-on's tests inside a real Blender, put together from Debian's packages
# make format      bring the code into the project's form
# make kernels     compile the kernels for every platform
# make extension   build the Blender extension and its repository into dist/, with the kernels of
#                  every platform
# make clean       remove the environment and everything that was built (runs stay)
#
# PYTHON       the Python (3.11 or later) that makes the environment
# TORCH_INDEX  a package index to take torch from; without it tools/install_torch.py finds a build
#              for the CPU. Example: TORCH_INDEX=https://download.pytorch.org/whl/cpu
# BLENDER      the Blender of `make test-blender` (default: made from Debian's packages) and of
#              `make extension` (default: its bpy module, from PyPI)
# SUITE        where test-blender takes it from: Debian's trixie (Blender 4.3, the default) or sid,
#              or a version of the bpy module on PyPI, such as 5.3
# RUN_DIR      where `make demo` puts its results

PYTHON ?= $(shell command -v python3.11 || command -v python3 || echo python3)
TORCH_INDEX ?=
export TORCH_INDEX
# The set-up leaves bytecode to the first import. Where nobody may keep it, every process of the
# tests compiles all that it imports.
unexport PYTHONDONTWRITEBYTECODE
RUN_DIR ?= runs/demo
BLENDER ?=
SUITE ?= trixie

# By file, as fixtures of a module are dear; a test process with Blender takes up to 1 GB.
PARALLEL := --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# Unpacks side by side and compiles no bytecode ahead: a third of pip's time.
UV := VIRTUAL_ENV=$(VENV) $(BIN)/uv pip install --quiet
BUILD_KERNELS = $(BIN)/python roigs_engine/kernels/build.py > /dev/null
# Compiles only what is older than its sources.
UPDATE_KERNELS = @$(BIN)/python -m roigs_engine.kernels.build > /dev/null

.PHONY: demo test types suite test-long test-blender format kernels extension clean

demo: $(VENV)/installed
	$(UPDATE_KERNELS)
	@$(BIN)/python tools/demo.py '$(RUN_DIR)'

test: $(VENV)/installed-dev
	$(UPDATE_KERNELS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@$(MAKE) --no-print-directory --jobs 2 types suite

# mypy has one process; a core would be idle beside it.
types:
	$(BIN)/mypy

# In a new environment, one process leaves the bytecode that all others would compile as well.
suite:
	@test -d tests/__pycache__ || $(BIN)/python -m pytest --collect-only -q > /dev/null || true
	$(BIN)/python -m pytest $(PARALLEL)

test-long: $(VENV)/installed-dev
	$(UPDATE_KERNELS)
	$(BIN)/python -m pytest -m slow

test-blender: $(VENV)/installed
	$(UPDATE_KERNELS)
	$(BIN)/python tools/blender_tests.py $(if $(BLENDER),--blender '$(BLENDER)',--suite $(SUITE)) -q

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

kernels: $(VENV)/installed-dev
	@for target in $$($(BIN)/python -c \
	    'from roigs_engine.kernels.build import PLATFORMS; print(*PLATFORMS)'); do \
	    $(BIN)/python -m roigs_engine.kernels.build --target $$target || exit 1; \
	done

extension: kernels
	$(BIN)/python tools/build_extension.py $(BLENDER)

# The environment is made once, and again when what it is made from has changed.
$(VENV)/tools: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("error: Python 3.11 or later is needed; run make PYTHON=..." if sys.version_info < (3, 11) else 0)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet uv
	$(UV) 'setuptools>=77' wheel 'ziglang>=0.15'
	@touch $@

$(VENV)/torch: $(VENV)/tools tools/install_torch.py
	$(BIN)/python tools/install_torch.py
	@touch $@

$(VENV)/kernels: $(VENV)/tools
	$(BUILD_KERNELS)
	@touch $@

# Torch is unpacked while the kernels compile. The rest waits for it: it depends on torch.
$(VENV)/built: $(VENV)/tools tools/install_torch.py
	@$(MAKE) --no-print-directory --jobs 2 $(VENV)/torch $(VENV)/kernels
	@touch $@

$(VENV)/installed: $(VENV)/built setup.py
	$(UV) --no-build-isolation --editable '.[train]'
	@touch $@

$(VENV)/installed-dev: $(VENV)/built setup.py
	$(UV) --no-build-isolation --editable '.[train,dev]'
	@touch $(VENV)/installed $@

clean:
	rm -rf $(VENV) .venv-blender build dist *.egg-info roigs_engine/kernels/lib
	rm -rf .blender .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find roigs_engine roigs_addon tests tools demo benchmarks -name __pycache__ -prune -exec rm -rf {} +
