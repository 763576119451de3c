#!/usr/bin/env python3
"""Checks that the links of a built site lead to its files: check_links.py FOLDER."""
import html.parser
import os
import sys
import urllib.parse


class Links(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        self.found += [value for name, value in attributes if name in ("href", "src") and value]


def broken(folder):
    """Page and link of each link that leads nowhere."""
    for path, _, names in os.walk(folder):
        for name in sorted(names):
            if not name.endswith(".html") or name in ("print.html", "404.html"):
                continue
            links = Links()
            with open(os.path.join(path, name)) as file:
                links.feed(file.read())
            for link in links.found:
                parts = urllib.parse.urlsplit(link)
                target = os.path.normpath(os.path.join(path, urllib.parse.unquote(parts.path)))
                if not parts.scheme and not parts.netloc and parts.path and not os.path.exists(target):
                    yield os.path.relpath(os.path.join(path, name), folder), link


if __name__ == "__main__":
    lost = list(broken(sys.argv[1]))
    for page, link in lost:
        print(f"{page}: {link} leads nowhere", file=sys.stderr)
    sys.exit(1 if lost else 0)
