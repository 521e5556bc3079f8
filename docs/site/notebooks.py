"""A notebook becomes a page: its text as it stands, its code as code, and no outputs, which tests see."""

from __future__ import annotations

import json
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page beside each notebook, of the same name."""
    for file in [*files]:
        if file.src_uri.endswith(".ipynb"):
            text = _page(Path(config.docs_dir) / file.src_uri)
            files.append(File.generated(config, file.src_uri.replace(".ipynb", ".md"), content=text))
    return files


def _page(notebook: Path) -> str:
    parts = []
    for cell in json.loads(notebook.read_text())["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    return "\n\n".join([*parts, f"[The notebook]({notebook.name})\n"])
