"""Elastic parameters from recorded motions."""
