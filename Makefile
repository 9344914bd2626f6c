# Everything a newcomer types. Needs only Python ≥ 3.11 and make: each target builds .venv from the lock by itself.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3; do \
  $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null && { echo $$p; break; }; done)
BIN := .venv/bin
SOURCES := ear_jax benchmarks experiments tests docs/site

.PHONY: setup demo test test-slow extras test-extras lint format bench bench-gpu docs lock

setup: .venv/.made

.venv/.made: requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "no Python between 3.11 and 3.13 found; set PYTHON=…" >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

demo: setup
	$(BIN)/ear demo

# Most of a test is compiling. Two processes; tests that share what is compiled run in one of them (tests/conftest.py).
test: setup
	$(BIN)/pytest --numprocesses 2 --no-loadscope-reorder

test-slow: setup
	$(BIN)/pytest -m slow

# Packages that the base installation does without, and the tests that are skipped where they are missing.
extras: setup
	$(BIN)/pip install --quiet --disable-pip-version-check --no-build-isolation --editable '.[cluster,onnx,wandb]'

test-extras: extras
	$(BIN)/pytest tests/runs/test_onnx.py tests/runs/test_tracking.py tests/runs/test_on_ray.py

lint: setup
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/mypy

format: setup
	$(BIN)/ruff check --fix $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

bench: setup
	$(BIN)/python -m benchmarks.physics
	$(BIN)/python -m benchmarks.update
	$(BIN)/python -m benchmarks.matmul
	$(BIN)/python -m benchmarks.chunk
	$(BIN)/python -m benchmarks.sweep
	$(BIN)/python -m benchmarks.startup
	$(BIN)/python -m benchmarks.adaptation
	$(BIN)/python -m benchmarks.saving
	$(BIN)/python -m benchmarks.scale
	$(BIN)/python -m benchmarks.peers
	$(BIN)/python -m benchmarks.time_to_return
	$(BIN)/python -m benchmarks.figures

# Needs an NVIDIA GPU and `pip install "jax[cuda12]"` in .venv; at most eight minutes. PyTorch's update is timed as well
# once `python -m benchmarks.peers --quick` has installed it beside, with CUDA where the index has that wheel.
bench-gpu: setup
	$(BIN)/python -m benchmarks.gpu --minutes 8

# The site, in build/site. What builds it is installed in a .venv-docs of its own, on top of .venv.
docs: .venv-docs/.made
	NO_MKDOCS_2_WARNING=1 .venv-docs/bin/mkdocs build --quiet --strict

.venv-docs/.made: setup requirements-docs.lock
	$(BIN)/python -m venv .venv-docs
	.venv-docs/bin/python -c "import site, pathlib, sys; pathlib.Path(site.getsitepackages()[0], 'ear_jax_venv.pth') \
	  .write_text(str(next(pathlib.Path('.venv/lib').glob('python3*/site-packages')).resolve()))"
	.venv-docs/bin/pip install --quiet --disable-pip-version-check --require-hashes -r requirements-docs.lock
	@touch $@

# Pins every package with hashes for Python 3.11 to 3.13, without an index's address. Needs uv.
lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	  --quiet --extra reach --group dev pyproject.toml --output-file requirements.lock
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	  --quiet --group docs --constraints requirements.lock --output-file requirements-docs.lock
