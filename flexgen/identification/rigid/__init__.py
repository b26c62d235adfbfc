"""Masses and friction of the rigid arm."""
