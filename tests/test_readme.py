"""What the README shows runs, prints what it says, and names what exists."""

import contextlib
import io
import re
import tomllib
from pathlib import Path

import pytest

from clfcbf import Status

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```\n\n```text\n(.*?)```", README, re.DOTALL)
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands():
    marked = r"<!-- (\w+) command -->\n```bash\n(.*?)```\n<!-- end -->"
    return dict(re.findall(marked, README, re.DOTALL))


def test_every_python_block_is_followed_by_its_output():
    assert EXAMPLES
    assert len(EXAMPLES) == README.count("```python")


@pytest.mark.parametrize(("code", "output"), EXAMPLES, ids=range(len(EXAMPLES)))
def test_example_prints_what_is_shown(code, output):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert printed.getvalue() == output


def test_status_table_is_complete():
    table = README[README.index("| status | command |") :].split("\n\n")[0]
    listed = re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE)
    assert sorted(listed) == sorted(status.value for status in Status)


def test_both_commands_set_up_all_they_need():
    assert set(commands()) == {"main", "test"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    for command in commands().values():
        first, second, third = (line.removesuffix(" &&") for line in command.strip().splitlines())
        assert first == "python3 -m venv .venv"
        named = re.search(r"'\.\[([\w,]+)\]'$", second).group(1).split(",")
        assert set(named) <= set(extras)
        assert third.startswith(".venv/bin/")


def test_named_options_exist():
    """The main command's options are fields of the subcommand of that name."""
    from clfcbf.cli import COMMANDS

    called = re.findall(r"\bclfcbf ([a-z]+)((?: --\w+ [\w.-]+)+)", README)
    assert called
    for name, options in called:
        fields = COMMANDS[name].__dataclass_fields__
        for option in re.findall(r"--(\w+)", options):
            assert option in fields, (name, option)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    local = [link for link in links if "://" not in link]
    missing = [link for link in local if not (page.parent / link).exists()]
    assert not missing


def test_no_placeholder_is_left():
    assert re.findall(r"\{\{.*?\}\}", README) == []
