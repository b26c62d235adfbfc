"""Elastic parameters from frequency responses."""
