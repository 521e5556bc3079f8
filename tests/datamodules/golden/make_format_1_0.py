"""The script that made ``format_1_0.hdf5``, run with the last code that wrote format 1.0 (commit 4626681).

The file holds four demonstrations of each task in two synthetic domains with cameras, without last observations. Later
code writes later formats, so the file is kept and never made anew. From the root of that commit:
``python tests/datamodules/golden/make_format_1_0.py``.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[2]), str(HERE.parents[1])]

import seen  # noqa: E402

from datamodules.store.writer import FORMAT_VERSION  # noqa: E402

if __name__ == "__main__":
    assert FORMAT_VERSION == "1.0", f"this code writes format {FORMAT_VERSION}"
    seen.write(HERE / "format_1_0.hdf5", count=4)
