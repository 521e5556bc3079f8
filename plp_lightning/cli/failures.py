"""Reasons why a verb failed, in a line for the user, where the program is not to blame."""

from __future__ import annotations

import re
import sys
import threading
import traceback

from datamodules.errors import UserError
from plp_lightning.stopping import PreemptedError

LOGGERS = re.compile(r"lightning\.(pytorch|fabric)\.loggers\.")


def tell_of_threads() -> None:
    """Let a thread that can't write, TensorBoard's for instance, say so in a line: what it lost stops no run."""
    threading.excepthook = _tell_of_thread


def _tell_of_thread(failed: threading.ExceptHookArgs) -> None:
    if isinstance(failed.exc_value, OSError):
        print(f"what a thread was writing is incomplete: {failed.exc_value}", file=sys.stderr)
    else:
        threading.__excepthook__(failed)


def answer_to(error: BaseException, way_on: str) -> tuple[str, int] | None:
    """Message and exit code for an error; None if it is a fault of the program, of which all should be seen."""
    if isinstance(error, UserError):
        return str(error), 2
    if isinstance(error, PreemptedError):
        return f"{error}; go on with {way_on}", error.exit_code
    if isinstance(error, OSError):
        # What the file system refused, and where: a full disk, say, or a folder that may not be written.
        place, reason = f"{error.filename}: " if error.filename else "", error.strerror or error
        return f"{place}{reason}; expected a place that can be read and written: free or name another", 2
    if _out_of_memory(error):
        found = " ".join(str(error).split())[:160] or type(error).__name__
        return f"out of memory ({found}); expected less: try smaller batches or sizes, then {way_on}", 2
    if any(LOGGERS.match(module) for module in _modules(error)):
        found = f"{type(error).__name__}: {' '.join(str(error).split())[:160]}"
        return f"a logger failed ({found}); expected one that can write: mend what it needs, then {way_on}", 2
    if _refused_by_lightning(error):
        return f"Lightning refuses this: {error}; mend the setting", 2
    return None


def _out_of_memory(error: BaseException) -> bool:
    """Python, numpy, torch and CUDA each have their own way to say it."""
    said = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
    return said or re.search("can't allocate memory|not enough memory|bad_alloc|out of memory", str(error)) is not None


def _refused_by_lightning(error: BaseException) -> bool:
    """True if Lightning itself raised an error: it finds some settings impossible only when training begins."""
    raised_in = (_modules(error) or [""])[-1]
    refusal = raised_in.startswith("lightning.") and isinstance(error, ValueError | RuntimeError | TypeError)
    return refusal or type(error).__name__ == "MisconfigurationException"


def _modules(error: BaseException) -> list[str]:
    """Modules that an error went through, that which raised it last."""
    return [str(frame.f_globals.get("__name__", "")) for frame, _ in traceback.walk_tb(error.__traceback__)]
