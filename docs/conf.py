"""How Sphinx builds these pages: `sphinx-build -W --keep-going docs docs/_build/html`."""

from __future__ import annotations

from importlib.metadata import version as _version
from typing import Any

project = "bayesnet_track"
author = "the bayesnet_track authors"
copyright = "the bayesnet_track authors, Apache-2.0"
release = version = _version("bayesnet-track")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "examples", "gallery/*.py", "gallery/*.ipynb", "sg_execution_times.rst"]
html_theme = "furo"
html_title = f"bayesnet_track {release}"
html_static_path: list[str] = []
html_theme_options = {"light_css_variables": {"code-font-size": "0.72rem"}}  # most lines of code fit
pygments_style = "friendly"
pygments_dark_style = "monokai"
templates_path: list[str] = []

# The pages are read on GitHub too: headings have its anchors, links are plain Markdown.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist"]

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_default_options = {"members": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
autosummary_generate = False

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1,
    "within_subsection_order": "FileNameSortKey",
    "write_computation_times": False,
}

# Every reference has to lead somewhere. Let pass are types of others, whose pages are not asked for over a
# network, types in signatures that have no page, and short names of errors under "Raises".
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|collections|os|pathlib|matplotlib)\..*"),
    (r"py:class", r"bayesnet_track\..*"),
    (r"py:class", r"CheckedGraph|GivenCue|MotionModel|NDArray|Path|PathLike|ValueRange|np\.float64"),
    (r"py:exc", r"\w+"),
]

# Words of formats and shells that Pygments does not know are shown plain.
suppress_warnings = ["misc.highlighting_failure", "config.cache"]


def setup(app: Any) -> None:
    """One thread per library while examples run, so that pictures are the same each time."""
    import os

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
