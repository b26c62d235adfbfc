"""Sweeps: grids of cases, solved in shards by any number of processes into one table; interrupted
sweeps can be resumed.
"""
