"""Records of real robots for all verbs that read them: files, names of columns, units,
instants.
"""
