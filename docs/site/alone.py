"""The site stands alone: its pages work from a disk and ask no other host for anything."""

from __future__ import annotations

import re

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.pages import Page

ASKS = re.compile(r"<(?:script|img|link|iframe|source|video)\b[^>]*?\b(?:src|href)=[\"']?((?:https?:)?//[^\"'\s>]+)")
ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):(?=<code>)")


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Raise if a page asks another host for a script, a style, a font or a picture."""
    asked = ASKS.findall(re.sub(r"<link[^>]*rel=[\"']?canonical[^>]*>", "", output))
    if asked:
        raise PluginError(f"{page.file.src_uri} asks {asked[0]}; expected nothing from other hosts: keep it in docs/")
    return output


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: object) -> str:
    """Leave out the roles of Sphinx that docstrings have before names in backquotes."""
    return ROLE.sub("", html)
