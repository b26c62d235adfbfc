function build_@NAME@ (varargin)
%BUILD_@NAMECAPITAL@  Compile the library @NAME@ for MATLAB or GNU Octave.
%
%   build_@NAME@            writes @NAME@_mex next to this file
%   build_@NAME@ (FLAG...)  with more flags for the compiler, such as '-O0'
%
%   Then add this folder to the path: addpath (FOLDER). Products and sums are not
%   contracted, so that the results have the bits of flexgen in Python.
%   Written by flexgen.

  here = fileparts (mfilename ('fullpath'));
  source = {fullfile(here, '@NAME@_mex.c'), fullfile(here, '@NAME@.c')};
  if exist ('OCTAVE_VERSION', 'builtin')
    output = fullfile (here, ['@NAME@_mex.' mexext()]);
    [report, status] = mkoctfile ('--mex', '-ffp-contract=off', '-fno-tree-vectorize', ['-I' here], varargin{:}, ...
                                  '-o', output, source{:});
    delete_objects (here);
    if status ~= 0
      error ('flexgen:build', 'build_@NAME@: the compiler failed, or there is none (Debian package octave-dev): %s', report);
    end
  elseif ispc
    mex ('-outdir', here, 'COMPFLAGS=$COMPFLAGS /fp:precise', varargin{:}, source{:});
  else
    mex ('-outdir', here, 'CFLAGS=$CFLAGS -ffp-contract=off', varargin{:}, source{:});
  end
end

function delete_objects (here)
  objects = {'@NAME@_mex.o', '@NAME@.o'};
  for k = 1:numel (objects)
    file = fullfile (here, objects{k});
    if exist (file, 'file')
      delete (file);
    end
  end
end
