"""Web pages of the engine: one file each, without network; all names are escaped."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable

from .text import printable

STYLE = """\
:root { color-scheme: light dark; }
body { margin: 0 auto; padding: 1em; max-width: 1100px; font: 16px/1.5 system-ui, sans-serif; }
h1, h2, figcaption { overflow-wrap: anywhere; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; }
th, td { padding: .3em .7em; border-bottom: 1px solid #8886; text-align: right; }
th { vertical-align: bottom; }
td { white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
li { font-size: .9em; }
.pictures { display: flex; flex-wrap: wrap; gap: 1.5em; margin: 1.5em 0; }
figure { margin: 0; max-width: 100%; }
.slider { position: relative; max-width: 100%; }
.slider img { display: block; width: 100%; height: 100%; }
.slider img + img { position: absolute; inset: 0; clip-path: inset(0 0 0 var(--at, 50%)); }
.slider::after { content: ""; position: absolute; top: 0; bottom: 0; left: var(--at, 50%);
  width: 2px; background: #ffa000; pointer-events: none; }
.slider input { position: absolute; inset: 0; width: 100%; height: 100%; margin: 0; opacity: 0;
  cursor: ew-resize; touch-action: pan-y; }
.slider:focus-within { outline: 2px solid #ffa000; }
select, summary { font: inherit; }
svg { max-width: 100%; height: auto; }
svg text { fill: currentColor; font-size: 13px; }"""


def whole_page(title: str, parts: Iterable[str], *, style: str = "", policy: str = "") -> str:
    """A page of these parts that uses no network; `style` and `policy` add to the usual ones."""
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'{policy}"
    head = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        f"<title>{html_text(title)}</title>",
        f"<style>{STYLE}{style}</style>",
        f"<h1>{html_text(title)}</h1>",
    ]
    return "\n".join([*head, *parts, "</html>", ""])


def html_text(text: str) -> str:
    """Escape text, as one line, for HTML text and attributes."""
    return html.escape(printable(" ".join(text.split())))


def picture(data: bytes, kind: str, alt: str = "") -> str:
    """An `img` element with the picture's data embedded; `kind` is `jpeg` or `png`."""
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return f'<img alt="{html_text(alt)}" src="{source}">'
