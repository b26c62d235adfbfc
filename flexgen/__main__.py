"""``python -m flexgen``: the command line."""

import sys

from flexgen.cli import main

if __name__ == "__main__":
    sys.exit(main())
