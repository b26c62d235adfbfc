"""Functions of an emitted library for MATLAB and GNU Octave: `export_mex`."""
