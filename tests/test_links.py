"""Links between the documents lead somewhere, and the tests that they name exist."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = (".", "docs", "notebook", "benchmarks", "demo")
DOCUMENTS = sorted(path for folder in FOLDERS for path in (ROOT / folder).glob("*.md"))
LINK = re.compile(r"""\]\(([^)\s]+)\)|(?:src|href)="([^"]+)\"""")
CODE = re.compile(r"```.*?```", re.DOTALL)


@cache
def anchors(document: Path) -> set[str]:
    """The anchors that GitHub gives to the headings of a document."""
    found: set[str] = set()
    for heading in re.findall(
        r"^#+ +(.+)$", CODE.sub("", document.read_text(encoding="utf-8")), re.M
    ):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
        slug = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        count = 0
        while (name := f"{slug}-{count}" if count else slug) in found:
            count += 1
        found.add(name)
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(document: Path) -> None:
    broken = []
    for match in LINK.finditer(CODE.sub("", document.read_text(encoding="utf-8"))):
        link = match.group(1) or match.group(2)
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (document.parent / name).resolve() if name else document
        if not target.exists() or (
            anchor and target.suffix == ".md" and anchor not in anchors(target)
        ):
            broken.append(link)
    assert not broken


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_tests_that_a_document_names_exist(document: Path) -> None:
    """A promise names its test: in full, or as in `tests/engine`."""
    named = re.findall(r"`([\w/]*test_\w+\.py)`", document.read_text(encoding="utf-8"))
    places = (ROOT, ROOT / "tests", ROOT / "tests" / "engine")
    alone = {path.name for path in (ROOT / "tests").rglob("test_*.py")}
    missing = [
        name
        for name in named
        if not any((place / name).is_file() for place in places) and name not in alone
    ]
    assert not missing
