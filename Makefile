# make render   set everything up and render the first picture
# make test     the tests (make test-all: also the slow ones)
# make coverage  which lines make test runs
# make references  what tests compare with and takes long to compute, where it is missing or a scene has changed
# make figures  the pictures and tables of the READMEs anew, which takes hours
# make lint     style and types; make format rewrites the files

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SCENE := scenes/bumpy_sphere/scene.xml
PICTURE := renders/bumpy_sphere.exr
FIGURES := renders/figures

.PHONY: render test test-all coverage references figures lint format llvm clean

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
	$(BIN)/python -m pytest -n 2 --cov --cov-report=term:skip-covered --deselect tests/test_commands.py::test_a_full_disk_keeps_the_earlier_picture

references: $(VENV)/.test llvm
	$(BIN)/python -m pytest -n 2 --make-references

# Pictures go to where READMEs show them, tables to FIGURES; what tests print, to the terminal.
figures: $(VENV)/.test llvm
	$(BIN)/python -m mitsuba_refscatter.benchmarks.figures scenes/gallery/method.png
	$(BIN)/refscatter render $(SCENE) -s 4 -D res=512 -o $(FIGURES)/bumpy_sphere.exr
	$(BIN)/refscatter render scenes/underwater/scene.xml -s 9 -D res=240 -o $(FIGURES)/underwater.exr
	$(BIN)/refscatter render scenes/amber/scene.xml -s 16 -o $(FIGURES)/amber.exr
	for name in bumpy_sphere underwater amber; do cp $(FIGURES)/$$name.png scenes/$$name/picture.png || exit 1; done
	$(BIN)/refscatter probe $(SCENE) --pixel 40 30 -D res=64 -o $(FIGURES)/probe
	cp $(FIGURES)/probe/probe.png scenes/gallery/probe.png
	$(BIN)/refscatter gallery -o scenes/gallery
	$(BIN)/refscatter tradeoff scenes/*/scene.xml --tolerance 0.1 --tolerance 0.01 --tolerance 0.001 --no-choices -D res=256 -o $(FIGURES)/tradeoff
	$(BIN)/refscatter scaling --method refscatter --method refscatter_exact_mesh --samples 16 -o $(FIGURES)/scaling
	$(BIN)/refscatter compare $(SCENE) --seconds 10 -o $(FIGURES)/compare
	$(BIN)/refscatter equal-error -o $(FIGURES)/equal_error
	$(BIN)/refscatter convergence -o $(FIGURES)/convergence
	$(BIN)/python -m pytest -m "" -s tests/test_extremes_against_oracle.py tests/test_worst_of_a_million_rays.py tests/test_image_against_oracle.py tests/test_references_of_compare.py

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
