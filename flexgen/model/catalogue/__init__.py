"""Model files for programs: their JSON schema, the list of models, and one model in full."""
