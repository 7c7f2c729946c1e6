"""How the documentation site is built: from this folder, ``examples`` and the package's docstrings.

It asks no host for anything, neither when it is built nor when it is read.
"""

import os
import sys
from pathlib import Path

import tvsysid

# Before NumPy is loaded: the examples' matrices are small
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent / "extensions"))
import pictures  # of that folder

project = "tvsysid"
author = copyright = "the tvsysid developers"
version = release = tvsysid.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_gallery.gen_gallery",
    "mathml",
    "options",
    "pictures",
    "reference",
    "browser",
]
exclude_patterns = ["learn/*.ipynb", "learn/*.py", "learn/*.zip", "generated/checks.md"]
suppress_warnings = ["config.cache"]
nitpicky = True
# What docstrings name of the package's inside, which has no page.
nitpick_ignore_regex = [
    (r"py:.*", r"tvsysid\.(numerics|arrays|methods\.cascade|methods\.(shared|kbr|\w+))\..*"),
    (r"py:.*", r"tvsysid\.numerics.*|ScheduledModel\.at|functools\.partial"),
    (r"py:data", r".*"),
]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
highlight_language = "text"
smartquotes = False  # options begin with two hyphens

autosummary_generate = False
autodoc_typehints = "none"
numpydoc_show_class_members = False
toc_object_entries = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "learn",
    "filename_pattern": r"\.py$",
    "image_scrapers": (pictures.scrape,),
    "reset_modules": ("matplotlib", "seaborn", pictures.use_palette),
    "capture_repr": (),
    "show_signature": False,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,  # what a builder takes says little
    "within_subsection_order": "FileNameSortKey",
    "copyfile_regex": r"",
}

html_theme = "pydata_sphinx_theme"
html_title = "tvsysid"
html_static_path = ["static"]
html_context = {"default_mode": "auto"}  # else the theme complains in the console
html_css_files = ["site.css"]
html_sidebars = {"start": []}  # its section has no other page
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navigation_with_keys": False,
    "navbar_persistent": ["search-button"],
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
