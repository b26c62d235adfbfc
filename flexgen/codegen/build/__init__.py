"""From the text of a library to compiled files, and their caches."""
