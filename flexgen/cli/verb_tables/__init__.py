"""Rows of the verbs and options of the command line."""
