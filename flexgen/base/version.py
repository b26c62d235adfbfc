"""The version of flexgen."""

__version__ = "0.3.0"
