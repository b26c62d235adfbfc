"""``python -m flexgen``: the command line."""

import sys

from flexgen.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
