"""NumPy docstrings whose sections say "names : what they are", without a type between."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

LISTS = ("Parameters", "Attributes")
"""Sections made of "names : what they are"."""

RAISES, RETURNS = "Raises", "Returns"

PROSE = ("Notes", "Examples", "References")
"""Sections of paragraphs."""


def as_fields(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """NumPy sections as fields; docstrings say "names : what they are", with no type between."""
    made: list[str] = []
    index = 0
    while index < len(lines):
        title = lines[index].strip()
        underlined = index + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[index + 1].strip())
        if not underlined or title not in (*LISTS, RAISES, RETURNS, *PROSE):
            made.append(lines[index])
            index += 1
            continue
        if title in PROSE:
            made += [f".. rubric:: {title}", ""]
            index += 2
            continue
        body, index = section(lines, index + 2)
        if title == RETURNS:
            made.append(f":returns: {body[0].strip() if body else ''}")
            made += indented(body[1:], 4)
        elif title == RAISES:
            for names, text in entries(body):
                made += [f":raises {names}: {text[0]}", *indented(text[1:], 4)]
        else:
            made += [f":{title}:", ""]
            for names, text in entries(body):
                bold = ", ".join(f"**{part.strip()}**" for part in names.split(","))
                made += [f"    * {bold} -- {text[0]}", *indented(text[1:], 6)]
        made.append("")
    lines[:] = made


def section(lines: list[str], begin: int) -> tuple[list[str], int]:
    """The lines of a section that begins there, and where the next one does."""
    end = begin
    while end < len(lines):
        if end + 1 < len(lines) and lines[end].strip() and re.fullmatch(r"-{3,}", lines[end + 1]):
            break
        # A paragraph that is neither a field nor indented ends the section as well.
        after_blank = end > begin and not lines[end - 1].strip()
        if after_blank and lines[end].strip() and not re.match(r"\s|[*\w, ]+ : ", lines[end]):
            break
        end += 1
    body = lines[begin:end]
    while body and not body[-1].strip():
        body.pop()
    return body, end


def entries(body: list[str]) -> list[tuple[str, list[str]]]:
    """Names of each entry of a section, and the lines of its text."""
    found: list[tuple[str, list[str]]] = []
    for line in body:
        match = re.match(r"([*\w][*\w, .]*?) : (.*)$", line)
        if match:
            found.append((match[1].replace("*", r"\*"), [match[2]]))
        elif found:
            found[-1][1].append(line)
        else:
            found.append((line.strip(), [""]))
    return found


def indented(lines: list[str], width: int) -> list[str]:
    """Lines of one paragraph or more, ``width`` columns in."""
    return [" " * width + line.strip() if line.strip() else "" for line in lines]


def skip_fields(
    app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object
) -> bool | None:
    """The class lists its fields under Attributes; what stands in for them says nothing."""
    if type(obj).__name__ in ("_tuplegetter", "member_descriptor"):
        return True
    return None


def setup(app: Sphinx) -> dict[str, Any]:
    """Register both."""
    app.connect("autodoc-process-docstring", as_fields)
    app.connect("autodoc-skip-member", skip_fields)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
