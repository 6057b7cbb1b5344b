# The configuration of the API site: Sphinx with the parser MyST and the theme Furo.
# `bin/docs` runs it on the Markdown that `mix situ.docs` writes.
import json
import os

here = os.path.dirname(os.path.abspath(__file__))
with open(os.path.join(os.environ["SITU_DOCS_SOURCE"], "navigation.json"), encoding="utf-8") as file:
    navigation = json.load(file)

project = "Situ"
release = version = os.environ["SITU_VERSION"]
html_title = f"Situ {version}"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
root_doc = "index"
highlight_language = "text"
# Pages have their links resolved already.
myst_all_links_external = True
myst_disable_syntax = ["myst_line_comment", "myst_block_break", "myst_target", "myst_role"]
suppress_warnings = ["myst.header", "misc.highlighting_failure"]

html_theme = "furo"
templates_path = [os.path.join(here, "templates")]
html_static_path = [os.path.join(here, "static")]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_sidebars = {
    "**": ["sidebar/brand.html", "sidebar/search.html", "sidebar/scroll-start.html", "navigation.html",
           "sidebar/scroll-end.html"]
}
html_context = {"site_navigation": navigation}
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_show_copyright = False
html_use_index = False
html_permalinks_icon = "#"


# Corrections of the theme's pages for assistive programs: names of landmarks, labels that only the mouse needs, and
# the empty corners of tables.
CORRECTIONS = [
    ('<aside class="sidebar-drawer">', '<aside class="sidebar-drawer" aria-label="Site">'),
    ('<aside class="toc-drawer', '<aside aria-label="This page" class="toc-drawer'),
    ('<label class="overlay ', '<label aria-hidden="true" class="overlay '),
    ('<th class="head"></th>', '<td></td>'),
    ('<div id="search-results">', '<h1 class="visually-hidden">Search</h1><div id="search-results">'),
    ('<th class="head"><p></p></th>', '<td></td>'),
]


def correct_pages(app, error):
    if error is not None:
        return
    for parent, _folders, files in os.walk(app.outdir):
        for name in files:
            if name.endswith(".html"):
                correct_page(os.path.join(parent, name))


def correct_page(path):
    with open(path, encoding="utf-8") as page:
        text = page.read()
    for wrong, right in CORRECTIONS:
        text = text.replace(wrong, right)
    with open(path, "w", encoding="utf-8") as page:
        page.write(text)


def setup(app):
    app.connect("build-finished", correct_pages)
