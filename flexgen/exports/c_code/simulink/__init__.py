"""Blocks of Simulink around an emitted library: `export_simulink`."""
