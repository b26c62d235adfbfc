classdef Stream < handle
%STREAM  Inverse dynamics of @NAME@ on a moving horizon.
%
%   s = @NAME@.Stream (y, q_start)
%   s = @NAME@.Stream (y, q_start, options)
%
%   Every update takes the next sample of a path, at the end of the horizon, and
%   gives the motion and the torques of the interval that begins now. The output
%   reaches the sample s.intervals updates later. The stream starts at rest at the
%   output y (@NT@ x 1); q_start (@NA@ x 1) is an initial guess of the equilibrium.
%
%   options  struct, all fields optional:
%     period                 [s] time between two updates (@PERIOD@)
%     intervals              of the horizon, 1 to 10000 (@INTERVALS@)
%     samples_per_interval   samples of the results, 1 to 1000 (@SAMPLES@)
%     tolerance              largest relative residual (@TOLERANCE@)
%     hold                   of the drive: 'spline' (default), 'linear' or 'zoh'
%     delay                  of the drive in samples, 0 to 4 (0)
%
%   [motion, info] = s.update (y, dy, ddy)
%     motion  struct with q_a, v_a (@NA@ x N), tau_g (@NG@ x N), q_m, v_m, tau_m (@NM@ x N),
%             N = samples_per_interval; SI units
%     info    struct; info.converged is false where the status is TOLERANCE_NOT_MET
%     A sample that is refused is an error, and changes nothing.
%   s.limits (torque_max, speed_max, deviation_max)
%     limits of the motors (@NM@ x 1, Inf: none) and the largest deviation of the path
%   s.all_limits (limits, deviation_max)
%     limits of all kinds in place of those, kept at the ends of the intervals; struct,
%     all fields optional; SI units, positive, Inf: none
%       torque_max, speed_max, torque_rate_max   of the motors (@NM@ x 1)
%       deflection_max                           of the coordinates without motor (@NE@ x 1)
%       gear_torque_max                          of the gears, arm side (@NG@ x 1)
%       joint_speed_max, joint_acceleration_max  of the joints with a motor (@NG@ x 1)
%       tool_speed_max, tool_acceleration_max    of a path of the tool
%       torque_speed   (2 P x @NM@) largest torques over the speed: P points of each motor
%                      below each other, each a speed and a torque, from speed 0 on
%   t = s.copy ()  a second stream with the same past
%
%   Written by flexgen.

  properties (SetAccess = private)
    period
    intervals
    samples_per_interval
  end

  properties (Access = private)
    numbers
    memory
  end

  methods
    function self = Stream (y, q_start, options)
      if nargin == 0
        return;  % of copy
      end
      if nargin < 3
        options = struct ();
      end
      defaults = struct ('period', @PERIOD@, 'intervals', @INTERVALS@, 'samples_per_interval', @SAMPLES@, ...
                         'tolerance', @TOLERANCE@, 'hold', 'spline', 'delay', 0);
      o = @NAME@.options_ ('Stream', options, defaults);
      self.period = o.period;
      self.intervals = o.intervals;
      self.samples_per_interval = o.samples_per_interval;
      self.numbers = [o.intervals, o.samples_per_interval, o.period, o.tolerance, o.hold, o.delay];
      self.memory = @NAME@_mex ('stream_start', self.numbers, y, q_start);
    end

    function [motion, info] = update (self, y, dy, ddy)
      self.check ();
      [next, q_a, v_a, ~, tau_g, q_m, v_m, tau_m, info] = ...
        @NAME@_mex ('stream_update', self.numbers, self.memory, y, dy, ddy);
      self.memory = next;
      motion = struct ('q_a', q_a, 'v_a', v_a, 'tau_g', tau_g, 'q_m', q_m, 'v_m', v_m, 'tau_m', tau_m);
    end

    function limits (self, torque_max, speed_max, deviation_max)
      self.check ();
      self.memory = @NAME@_mex ('stream_limits', self.numbers, self.memory, torque_max, speed_max, deviation_max);
    end

    function all_limits (self, limits, deviation_max)
      self.check ();
      if ~isstruct (limits) || numel (limits) ~= 1
        error ('flexgen:argument', 'all_limits: given %s, expected a struct', class (limits));
      end
      names = {'torque_max', 'speed_max', 'deflection_max', 'gear_torque_max', 'torque_rate_max', ...
               'joint_speed_max', 'joint_acceleration_max', 'tool_speed_max', 'tool_acceleration_max', 'torque_speed'};
      given = cell (1, numel (names));
      found = fieldnames (limits);
      for k = 1:numel (found)
        at = find (strcmp (found{k}, names));
        if isempty (at)
          error ('flexgen:argument', 'all_limits: given %s, expected some of%s', found{k}, sprintf (' %s', names{:}));
        end
        given{at} = limits.(found{k});
      end
      self.memory = @NAME@_mex ('stream_all_limits', self.numbers, self.memory, given{:}, deviation_max);
    end

    function other = copy (self)
      other = @NAME@.Stream ();
      other.period = self.period;
      other.intervals = self.intervals;
      other.samples_per_interval = self.samples_per_interval;
      other.numbers = self.numbers;
      other.memory = self.memory;
    end
  end

  methods (Access = private)
    function check (self)
      if isempty (self.memory)
        error ('flexgen:argument', 'Stream: given one that was not started, expected Stream (y, q_start)');
      end
    end
  end
end
