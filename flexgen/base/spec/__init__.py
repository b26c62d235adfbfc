"""Rows that state a fact once, and plain functions that render them; knows no robot."""
