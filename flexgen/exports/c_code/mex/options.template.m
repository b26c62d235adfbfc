function o = options_ (what, given, defaults)
%OPTIONS_  Options of @NAME@.invert and @NAME@.Stream with their defaults; the hold as a number.
%   Written by flexgen.

  if ~isstruct (given) || numel (given) ~= 1
    error ('flexgen:argument', '%s, options: given %s, expected a struct', what, class (given));
  end
  o = defaults;
  allowed = fieldnames (defaults);
  names = fieldnames (given);
  for k = 1:numel (names)
    if ~isfield (defaults, names{k})
      error ('flexgen:argument', '%s, options: given %s, expected some of%s', what, names{k}, ...
             sprintf (' %s', allowed{:}));
    end
    o.(names{k}) = given.(names{k});
  end
  holds = {'spline', 'linear', 'zoh'};
  hold = find (strcmp (o.hold, holds));
  if isempty (hold)
    error ('flexgen:argument', '%s, hold: expected spline, linear or zoh', what);
  end
  o.hold = hold - 1;
  names = fieldnames (o);
  for k = 1:numel (names)
    if ~isnumeric (o.(names{k})) || numel (o.(names{k})) ~= 1
      error ('flexgen:argument', '%s, %s: expected a number', what, names{k});
    end
  end
end
