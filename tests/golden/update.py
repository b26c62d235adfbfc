"""Write all golden texts, or those of some names: ``python tests/golden/update.py [NAME ...]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
from registry import GOLDEN, ROOT


def main() -> None:
    """Write the texts and print their files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(GOLDEN))
    names = parser.parse_args().names or list(GOLDEN)
    unknown = sorted(set(names) - set(GOLDEN))
    if unknown:
        parser.error(f"given {unknown[0]}, expected some of {', '.join(GOLDEN)}")
    for name in names:
        for path in GOLDEN[name].write():
            print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
