"""What the pages need beside Sphinx's own: notebooks, citations, names, and the public ones."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import jupytext
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.addnodes import desc_signature, pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

REFERENCES = "references"
"""The page that holds the list of sources."""

KEY = re.compile(r"^\[([A-Za-z][\w.-]*)\]$")


def write_notebooks(app: Sphinx, config: object) -> None:
    """Notebooks are kept as scripts beside the pages; Sphinx reads only what is below them."""
    source = Path(app.confdir).parent / "notebooks"
    target = Path(app.srcdir) / "notebooks"
    target.mkdir(exist_ok=True)
    scripts = {path.stem: path for path in sorted(source.glob("*.py"))}
    for old in target.glob("*.ipynb"):
        if old.stem not in scripts:
            old.unlink()
    for name, path in scripts.items():
        made = target / f"{name}.ipynb"
        # One that is newer than its script is left alone, and with it what is cached of it.
        if not made.exists() or made.stat().st_mtime < path.stat().st_mtime:
            jupytext.write(jupytext.read(path), made, fmt="ipynb")


def mark_references(app: Sphinx, doctree: nodes.document) -> None:
    """Give each entry of the list of sources its key as an anchor."""
    if app.env.docname != REFERENCES:
        return
    keys: set[str] = set()
    for item in doctree.findall(nodes.list_item):
        strong = next(iter(item.findall(nodes.strong)), None)
        match = KEY.match(strong.astext()) if strong is not None else None
        if match:
            item["ids"].append(f"ref-{match[1].lower()}")
            keys.add(match[1])
    app.env.clfcbf_references = keys  # type: ignore[attr-defined]


def qualify(app: Sphinx, doctree: nodes.document) -> None:
    """Names in signatures and roles mean what they mean in the module that uses them."""
    for node in doctree.findall(pending_xref):
        if node.get("refdomain") != "py" or not node.get("py:module"):
            continue
        first, dot, rest = node.get("reftarget", "").partition(".")
        for module in scopes(node):
            found = getattr(module, first, None)
            if hasattr(found, "__qualname__") and hasattr(found, "__module__"):
                node["reftarget"] = f"{found.__module__}.{found.__qualname__}{dot}{rest}"
                break


def scopes(node: pending_xref) -> list[ModuleType]:
    """The module of a reference, and those of the bases of the class whose signature it is in."""
    module = importlib.import_module(node["py:module"])
    parent = node.parent
    while parent is not None and not isinstance(parent, desc_signature):
        parent = parent.parent
    name = "" if parent is None else parent.get("fullname", "").partition(".")[0]
    owner = getattr(module, name, None)
    return [module, *(sys.modules[base.__module__] for base in getattr(owner, "__mro__", ()))]


def merge_references(
    app: Sphinx, env: BuildEnvironment, docnames: object, other: BuildEnvironment
) -> None:
    """Bring what a reading process found to the one that writes."""
    if hasattr(other, "clfcbf_references"):
        env.clfcbf_references = other.clfcbf_references  # type: ignore[attr-defined]


def resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.reference | None:
    """Citations lead to the list of sources, public names to where they are defined."""
    target = node["reftarget"]
    if node.get("refdomain") == "citation":
        if target not in getattr(env, "clfcbf_references", ()):
            return None
        text = nodes.inline("", f"[{target}]")
        page, anchor = REFERENCES, f"ref-{target.lower()}"
        return make_refnode(app.builder, node["refdoc"], page, anchor, text, target)
    if node.get("refdomain") == "py":
        target = canonical(target if "." in target else f"clfcbf.{target}")
        if target != node["reftarget"]:
            domain = env.domains.python_domain
            return domain.resolve_xref(
                env, node["refdoc"], app.builder, "obj", target, node, content
            )  # type: ignore[return-value]
    return None


def canonical(name: str) -> str:
    """The full name of what a package passes on, such as ``clfcbf.Plan``: where it is defined."""
    package, _, rest = name.rpartition(".")
    member = ""
    while package.startswith("clfcbf"):
        try:
            module = importlib.import_module(package)
        except ImportError:
            package, _, last = package.rpartition(".")
            rest, member = last, f".{rest}{member}"
            continue
        found = getattr(module, rest, None)
        if found is None or not hasattr(found, "__qualname__"):
            return name
        return f"{found.__module__}.{found.__qualname__}{member}"
    return name


class PublicNames(SphinxDirective):
    """``.. public-names::`` lists what ``import clfcbf`` gives, by room."""

    def run(self) -> list[nodes.Node]:
        """A table of names with their first sentences, linked to where they are defined."""
        package = importlib.import_module("clfcbf")
        lines = [".. autosummary::", ""]
        lines += [f"   ~{canonical(f'clfcbf.{name}')}" for name in sorted(package.__all__)]
        parent = nodes.container()
        self.state.nested_parse(StringList(lines, source="public-names"), 0, parent)
        return parent.children


def setup(app: Sphinx) -> dict[str, Any]:
    """Register all of it."""
    app.connect("config-inited", write_notebooks)
    app.connect("doctree-read", mark_references)
    app.connect("doctree-read", qualify)
    app.connect("env-merge-info", merge_references)
    app.connect("missing-reference", resolve)
    app.add_directive("public-names", PublicNames)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
