"""How `./fenicsx docs` builds the documentation."""

import os
import shutil
import sys
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from thinlayer import __version__ as release  # noqa: E402, F401

project, copyright = "thinlayer", "the thinlayer authors, MIT licence"
SPHINX = [f"sphinx.ext.{name}" for name in ("autosummary", "intersphinx", "napoleon")]
extensions = ["listings", "myst_nb", "sphinx_copybutton", *SPHINX, "docstrings"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

# Pages with `file_format: mystnb` in their head are notebooks: they are run, and may be downloaded with their outputs
nb_execution_mode = "cache"  # in out/.jupyter_cache; a page whose code has not changed is not run again
nb_execution_in_temp = True  # files that cells save are not left among the pages
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # s, of a cell
nb_output_stderr = "remove"  # progress
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # as in Jupyter

default_role = "code"  # single backticks in docstrings
autodoc_member_order, autodoc_typehints = "bysource", "none"
napoleon_use_ivar, napoleon_attr_annotations = True, False
autosummary_generate = [str(path) for path in HERE.glob("reference/api/*.md")]
shutil.rmtree(HERE / "reference/generated", ignore_errors=True)  # with pages of names that are gone
templates_path = ["_templates"]

# Links into other references need their inventories, and so a network: THINLAYER_LINKS=1 ./fenicsx docs.
DOLFINX = "https://docs.fenicsproject.org/dolfinx/v0.9.0/python"
OTHERS = {"python": "https://docs.python.org/3", "numpy": "https://numpy.org/doc/stable", "dolfinx": DOLFINX}
intersphinx_mapping = {name: (url, None) for name, url in OTHERS.items()} if os.environ.get("THINLAYER_LINKS") else {}

# MathJax in one file, with its font: pages need no network
mathjax_path = "tex-svg-full.js"
OFFLINE = metadata.distribution("sphinx-mathjax-offline")
MATHJAX = OFFLINE.locate_file(f"sphinx-mathjax-offline/static/mathjax/{mathjax_path}")
html_theme, html_show_sourcelink = "pydata_sphinx_theme", False
html_static_path = ["_static", str(MATHJAX)]
html_css_files = ["thinlayer.css"]
html_title, html_logo, html_favicon = "thinlayer", "_static/logo.svg", "_static/logo.svg"
html_theme_options = {"show_toc_level": 2, "header_links_before_dropdown": 8, "logo": {"text": "thinlayer"}}
html_theme_options |= {"footer_start": ["copyright"], "footer_end": []}
highlight_language = "text"  # of indented blocks
copybutton_prompt_text = r">>> |\.\.\. "  # examples of docstrings are copied without their prompts
copybutton_prompt_is_regexp = True
