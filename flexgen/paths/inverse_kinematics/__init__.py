"""Joint configurations that reach a pose of the tool: all of them, or the one that is asked
for.
"""
