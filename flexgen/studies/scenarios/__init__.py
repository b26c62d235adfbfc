"""Benchmarks of robot controllers: frozen scenarios, their measures and scores."""
