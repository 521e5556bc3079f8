"""``python -m plp_lightning.sweeps.bound PID COMMAND …``: a command that the kernel ends when process PID ends."""

from __future__ import annotations

import os
import sys

from plp_lightning.parent import end_with_parent


def main() -> None:
    """Bind this process to its parent, then become the command."""
    parent, *command = sys.argv[1:]
    end_with_parent()
    if os.getppid() != int(parent):  # it has ended before
        sys.exit(1)
    os.execv(command[0], command)


if __name__ == "__main__":
    main()
