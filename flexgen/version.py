"""The version of flexgen."""

__version__ = "0.2.0"
