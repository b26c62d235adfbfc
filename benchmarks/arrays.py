"""Throughput of many stable inversions: `invert_many` on all cores against single calls of
`invert`.

    python benchmarks/arrays.py [MODEL ...]

prints the table and, for its own choice of models, writes it to benchmarks/arrays.md. Every
problem has the line of the model (501 samples, 20 before and 50 after them, 20 for each interval
of the mesh) and its own stiffness and payload. All ways solve the same problems in turns, round
after round; the shortest times of each are in the table. Where other programs use the cores too,
threads cannot show what they gain: the processor times show what they cost.
"""

from __future__ import annotations

import sys
from pathlib import Path

from array_parts.table import MODELS, measure

if __name__ == "__main__":
    text = measure(sys.argv[1:] or MODELS)
    print(f"\n{text}")
    if not sys.argv[1:]:
        Path(__file__).with_name("arrays.md").write_text(text, encoding="utf-8")
