"""Checks the API site in a folder: every link and anchor of a page has its target, no page needs another server, and
every public module and function is there. Prints one line per problem, and exits with 1 if there are any."""
import html.parser
import os
import re
import sys
import urllib.parse

folder, api, signatures = sys.argv[1:]
external = re.compile(r"^(https?:|mailto:|data:)")


class Page(html.parser.HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.resources = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        if "id" in values:
            self.ids.add(values["id"])
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        for name in ("src", "srcset"):
            if values.get(name):
                self.resources.append(values[name])
        if tag == "link" and values.get("rel") in ("stylesheet", "icon", "preload"):
            self.resources.append(values["href"])


pages = {}
for parent, _folders, files in os.walk(folder):
    for name in files:
        if name.endswith(".html"):
            path = os.path.join(parent, name)
            with open(path, encoding="utf-8") as file:
                pages[os.path.relpath(path, folder)] = Page(file.read())

problems = []
count = 0
for name, page in pages.items():
    for link in page.resources:
        if external.match(link) and not link.startswith("data:"):
            problems.append(f"{name} loads {link}")
    for link in page.links + page.resources:
        if external.match(link):
            continue
        count += 1
        path, _, fragment = link.partition("#")
        path = urllib.parse.unquote(path.partition("?")[0])
        target = os.path.normpath(os.path.join(os.path.dirname(name), path)) if path else name
        if link.startswith("/") or target.startswith(".."):
            problems.append(f"{name}: {link} leaves the site")
        elif not os.path.exists(os.path.join(folder, target)):
            problems.append(f"{name}: no page for {link}")
        elif fragment and target in pages and urllib.parse.unquote(fragment) not in pages[target].ids:
            problems.append(f"{name}: no anchor for {link}")

with open(api, encoding="utf-8") as file:
    modules = re.findall(r"^\| `([A-Z][\w.]*)` \|", file.read(), re.M)
for module in modules:
    if f"api/{module}.html" not in pages:
        problems.append(f"no page for {module}")
functions = 0
with open(signatures, encoding="utf-8") as file:
    for line in file:
        found = re.match(r"^(?:stable|experimental) ([ct]:)?([A-Z][\w.]*)\.([^. ]+/\d+)(?: \(deprecated\))?$", line)
        if found:
            functions += 1
            kind, module, name = found.groups()
            page = pages.get(f"api/{module}.html")
            if page is None or (kind or "") + name not in page.ids:
                problems.append(f"{module}: no anchor for {kind or ''}{name}")

print("\n".join(sorted(set(problems))))
print(f"{len(pages)} pages, {count} internal links, {len(modules)} modules, {functions} functions")
sys.exit(1 if problems else 0)
