"""Arguments of the verbs of exchange: ``export mujoco``, ``export urdf``, ``schema``, ``view``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flexgen.cli.argument_types import file_path
from flexgen.cli.exchange import mujoco, schema, urdf, view

FRICTION = (
    "exact (the default): a model with Coulomb or Stribeck friction is refused; viscous: these are left out; dry: "
    "Coulomb friction as MuJoCo has it, with other accelerations"
)


def add_mujoco(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add ``export mujoco``."""
    parser = add_verb(kinds, "mujoco", mujoco)
    content, files = parser.section("content"), parser.section("files")
    files.add_argument("--out", metavar="FILE", type=file_path, required=True, help="write the MJCF file, FILE.xml")
    content.add_argument(
        "--friction", metavar="NAME", choices=("exact", "viscous", "dry"), default="exact", help=FRICTION
    )


def add_urdf(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add ``export urdf``."""
    parser = add_verb(kinds, "urdf", urdf)
    files = parser.section("files")
    help_out = "write the URDF file, FILE.urdf, and beside it the overlay, FILE.toml"
    files.add_argument("--out", metavar="FILE", type=file_path, required=True, help=help_out)


def add_verbs(group: Any, add_verb: Callable[..., Any]) -> None:
    """Add the verbs view and schema."""
    parser = add_verb(group, "view", view)
    motion, files = parser.section("motion"), parser.section("files")
    files.add_argument("--out", metavar="FILE", type=file_path, help="write the page to this file, FILE.html")
    motion.add_argument("--move", metavar="NAME", help="a move or program of the model file; default: the first")
    help_robot = "the model of a trajectory, where MODEL is a file .npz or .csv; default: the name in the trajectory"
    motion.add_argument("--robot", metavar="MODEL", help=help_robot)
    help_video = "write a video to this file, FILE.gif or FILE.mp4 (needs the program ffmpeg)"
    files.add_argument("--video", metavar="FILE", type=file_path, help=help_video)
    parser = add_verb(group, "schema", schema, model=False)
    help_kind = "model (the default), or program: files of moves and programs"
    parser.add_argument(
        "kind", metavar="KIND", nargs="?", choices=("model", "program"), default="model", help=help_kind
    )
    parser.section("files").add_argument("--out", metavar="FILE", type=file_path, help="write the schema to this file")
