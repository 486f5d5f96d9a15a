"""Every source cited in the library is in the references page, and nothing else is."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
KEY = r"[A-Z][A-Za-z]+[0-9]{4}[a-z]?"


def cited():
    """Keys of the library's docstrings; one broken over two lines would not be found."""
    return {
        key
        for path in sorted((ROOT / "clfcbf").rglob("*.py"))
        for key in re.findall(rf"\[({KEY})\]_", path.read_text(encoding="utf-8"))
    }


def listed():
    page = (ROOT / "docs" / "references.md").read_text(encoding="utf-8")
    return re.findall(rf"^- \*\*\[({KEY})\]\*\* ", page, re.MULTILINE)


def test_every_key_is_listed_and_every_listed_key_is_used():
    keys = cited()
    assert "Xie2024" in keys
    assert keys == set(listed())


def test_list_is_sorted_and_each_key_is_there_once():
    keys = listed()
    assert keys == sorted(set(keys), key=str.lower)


def test_no_key_lacks_the_underscore_that_makes_it_a_citation():
    for path in sorted((ROOT / "clfcbf").rglob("*.py")):
        bare = re.findall(rf"\[{KEY}\](?!_)", path.read_text(encoding="utf-8"))
        assert not bare, f"{path.name}: {bare}"


def test_year_of_each_entry_is_that_of_its_key():
    page = (ROOT / "docs" / "references.md").read_text(encoding="utf-8")
    entries = re.split(r"^- ", page, flags=re.MULTILINE)[1:]
    for entry in entries:
        (year,) = re.search(r"([0-9]{4})[a-z]?\]", entry).groups()
        assert entry.rstrip().endswith(f"{year}."), entry
