"""The emitted C of a library on NVIDIA GPUs: `flexgen.load` with ``device="cuda"``."""
