"""From equations to C: fewer operations, statements, files, compiled libraries."""
