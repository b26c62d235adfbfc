"""Many at once: grids of cases, solved in shards that can be resumed, in any number of processes,
into one table.
"""
