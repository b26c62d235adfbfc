function [motion, info] = invert (y, dy, ddy, period, q_start, options)
%INVERT  Inverse dynamics along a whole path of @NAME@.
%
%   [motion, info] = @NAME@.invert (y, dy, ddy, period, q_start)
%   [motion, info] = @NAME@.invert (y, dy, ddy, period, q_start, options)
%
%   Motion of arm and motors, and motor torques, for exact tracking of the output,
%   also where the zero dynamics is unstable. SI units; a column is a sample.
%
%   y        @NT@ x n   output; for a pose the position, then the rotation matrix by columns
%   dy, ddy  @NY@ x n   its time derivatives; for a pose linear and angular
%   period   [s]     time between two samples
%   q_start  @NA@ x 1   initial guess of the equilibrium at the first sample
%   options  struct, all fields optional:
%     n_pre, n_post          samples before and after the path (0)
%     samples_per_interval   of the mesh (1)
%     tolerance              largest relative residual (@TOLERANCE@)
%     hold                   of the drive: 'spline' (default), 'linear' or 'zoh'
%     delay                  of the drive in samples, 0 to 4 (0)
%
%   motion   struct with q_a, v_a, a_a (@NA@ x N), tau_g (@NG@ x N), q_m, v_m, tau_m (@NM@ x N),
%            N = n_pre + n + n_post
%   info     struct; info.converged is false where the status is TOLERANCE_NOT_MET
%
%   A failure is an error with the identifier flexgen:<STATUS>.
%   Written by flexgen.

  if nargin < 6
    options = struct ();
  end
  defaults = struct ('n_pre', 0, 'n_post', 0, 'samples_per_interval', 1, 'tolerance', @TOLERANCE@, ...
                     'hold', 'spline', 'delay', 0);
  o = @NAME@.options_ ('invert', options, defaults);
  numbers = [o.n_pre, o.n_post, o.samples_per_interval, o.tolerance, o.hold, o.delay];
  [q_a, v_a, a_a, tau_g, q_m, v_m, tau_m, info] = @NAME@_mex ('invert', y, dy, ddy, period, q_start, numbers);
  motion = struct ('q_a', q_a, 'v_a', v_a, 'a_a', a_a, 'tau_g', tau_g, 'q_m', q_m, 'v_m', v_m, 'tau_m', tau_m);
end
