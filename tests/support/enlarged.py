"""Model files of robots of another size: all lengths times a factor, the same density and gravity.

Masses then grow with the third power of the factor, times with its root, and every answer with its dimension.
"""

from __future__ import annotations

import re
from pathlib import Path

NUMBER = r"-?\d[\d.e+-]*"
# powers of the factor; inertia: of a body and of a rotor
POWERS = {"com": 1.0, "position": 1.0, "displacement": 1.0, "mass": 3.0, "duration": 0.5, "inertia": 5.0}
POWERS |= {"stiffness": 4.0, "damping": 4.5}  # of rotary springs


def enlarged(name: str, factor: float) -> str:
    """The text of the model `name` with lengths `factor` times as large, without its variants; rotary springs only."""
    text = (Path(__file__).parents[2] / "models" / f"{name}.toml").read_text("utf-8").partition("[variant")[0]

    def scaled(found: re.Match[str]) -> str:
        size = factor ** POWERS[found[1]]
        return f"{found[1]} = {re.sub(NUMBER, lambda number: repr(size * float(number[0])), found[2])}"

    return re.sub(rf"\b({'|'.join(POWERS)}) = (\[[^\]]*\]|{NUMBER})", scaled, text)
