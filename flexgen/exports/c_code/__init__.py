"""The emitted C for other programs: MATLAB, Simulink, PLC, self-test."""
