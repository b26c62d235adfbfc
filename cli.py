"""The command line from a clone: ``python cli.py ...`` is ``flexgen ...`` without an
installation.
"""

import os
import sys

if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit("flexgen: Python " + sys.version.split()[0] + " is too old, expected 3.11 or newer")

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

from flexgen.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
