function setup_@NAME@ (model)
%SETUP_@NAMECAPITAL@  Blocks of @NAME@ for Simulink.
%
%   setup_@NAME@            compiles the S-functions next to this file
%   setup_@NAME@ (MODEL)    also adds the functions of @NAME@_ccaller.h to the custom code of an open
%                       model, for blocks of type C Caller
%
%   Written by flexgen.

  here = fileparts (mfilename ('fullpath'));
  blocks = {@BLOCKS@};
  for k = 1:numel (blocks)
    sources = {fullfile(here, blocks{k}), fullfile(here, '@NAME@_ccaller.c'), fullfile(here, '@NAME@.c')};
    if ispc
      mex ('-outdir', here, 'COMPFLAGS=$COMPFLAGS /fp:precise', sources{:});
    else
      mex ('-outdir', here, 'CFLAGS=$CFLAGS -std=c99 -ffp-contract=off', sources{:});
    end
  end
  addpath (here);
  if nargin > 0
    set_param (model, 'SimCustomHeaderCode', '#include "@NAME@_ccaller.h"');
    set_param (model, 'SimUserIncludeDirs', here);
    set_param (model, 'SimUserSources', sprintf ('%s\n%s', fullfile (here, '@NAME@_ccaller.c'), fullfile (here, '@NAME@.c')));
    set_param (model, 'CustomHeaderCode', '#include "@NAME@_ccaller.h"');
    set_param (model, 'CustomInclude', here);
    set_param (model, 'CustomSource', sprintf ('%s\n%s', fullfile (here, '@NAME@_ccaller.c'), fullfile (here, '@NAME@.c')));
  end
end
