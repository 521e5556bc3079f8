"""``python -m plp_lightning`` is the same as ``plp``."""

from plp_lightning.cli.main import main

if __name__ == "__main__":
    main()
