"""A program in C that tests an emitted library on its target, against numbers of the definition:
`export_selftest`.
"""
