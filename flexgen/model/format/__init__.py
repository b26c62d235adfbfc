"""The keys of model files."""
