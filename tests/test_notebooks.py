"""Notebooks as they are committed; ``make test-all`` executes them."""

import json
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"
README = FOLDER.parent / "README.md"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def test_the_readme_lists_them_in_order():
    """Under the titles that they have."""
    listed = re.findall(r"^\| \[(.+?)\]\(notebooks/(.+?)\) \|", README.read_text(encoding="utf-8"), re.MULTILINE)
    assert [name for _, name in listed] == [path.name for path in NOTEBOOKS] and listed
    for title, name in listed:
        first = json.loads((FOLDER / name).read_text(encoding="utf-8"))["cells"][0]["source"]
        assert "".join(first).splitlines()[0] == f"# {title}"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_as_committed(path):
    """Without outputs; a title and what one learns; links lead to files that are there."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
    text = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    assert text[0].startswith("# ") and "You will learn how to" in text[0]
    for target in re.findall(r"\]\(([^)#]+\.ipynb)\)", "\n".join(text)):
        assert (FOLDER / target).exists(), target
    assert any("assert" in "".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
