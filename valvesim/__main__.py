"""`python -m valvesim`: the command line."""

import sys

from valvesim.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
