"""Sphinx configuration: ``python -m sphinx -W --keep-going -b html docs docs/_build``."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))
sys.path.insert(0, str(HERE.parent))

import clfcbf  # noqa: E402  # the checkout's own, whatever is installed

project = "clfcbf"
author = "The clfcbf developers"
copyright = f"{author}, Apache-2.0"
version = release = clfcbf.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "myst_nb",
    "clfcbf_docs",
    "docstring_fields",
]
exclude_patterns = [
    "_build", "_ext", "_templates", "jupyter_execute", ".jupyter_cache", "**.ipynb_checkpoints",
]  # fmt: skip
templates_path = ["_templates"]

# The API: docstrings in NumPy style, each module on a page of its own.
autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True}
add_module_names = False
python_use_unqualified_type_names = True

# Prose and notebooks: MyST, executed once and then taken from a cache.
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath", "deflist"]
myst_fence_as_directive = ["math"]  # as GitHub renders it too
myst_heading_anchors = 3
myst_links_external_new_tab = True
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / ".jupyter_cache")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
math_eqref_format = "({number})"
numfig = True

html_theme = "furo"
html_title = f"clfcbf {release}"
html_theme_options = {"navigation_with_keys": True}
copybutton_exclude = ".linenos, .gp, .go"
