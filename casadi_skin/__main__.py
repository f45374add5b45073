"""The command line as `python -m casadi_skin`."""

import sys

from casadi_skin.cli import main

if __name__ == "__main__":
    sys.exit(main())
