# make render   set everything up and render the first picture
# make test     the tests (make test-all: also the slow ones)
# make coverage  which lines make test runs
# make references  what tests compare with and takes long to compute, where it is missing or a scene has changed
# make lint     style and types; make format rewrites the files

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SCENE := scenes/bumpy_sphere/scene.xml
PICTURE := renders/bumpy_sphere.exr

.PHONY: render test test-all coverage references lint format llvm clean

render: $(VENV)/.package llvm
	$(BIN)/refscatter render $(SCENE) -o $(PICTURE)

test: $(VENV)/.test llvm
	$(BIN)/python -m pytest -n 2

# worksteal: tests of a file stay together, and neither half waits long for the other.
test-all: $(VENV)/.test llvm
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "" --references-anew
	$(BIN)/python -m pytest -n 2 --dist worksteal --nbmake notebooks

# Without the test of a full disk, on which coverage itself can't be written.
coverage: $(VENV)/.test llvm
	$(BIN)/python -m pytest -n 2 --cov --cov-report=term:skip-covered --deselect tests/test_cli.py::test_a_full_disk_keeps_the_earlier_picture

references: $(VENV)/.test llvm
	$(BIN)/python -m pytest -n 2 --make-references

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(VENV)/.test
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

# Something that Dr.Jit can compile with: a usable LLVM or GPU.
llvm: $(VENV)/.package
	@.ci/ensure-llvm $(BIN)/python

$(VENV)/.package: pyproject.toml
	.ci/make-venv $(PYTHON) $(VENV)
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.test: $(VENV)/.package
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	@touch $@

clean:
	rm -rf $(VENV) .cache renders build *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
