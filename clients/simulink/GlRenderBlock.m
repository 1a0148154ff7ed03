classdef GlRenderBlock < matlab.System
%GLRENDERBLOCK  MATLAB System block: a camera's frame per sample time, from a glrender server.
%   Signals as in sfun_glrender; runs by interpreted execution. In plain MATLAB:
%   block = GlRenderBlock('Camera', 'navcam', 'ImageSize', [1024 1024]); [image, facts] = block(r_sun, spacecraft, bodies);

  properties (Nontunable)
    Host = '127.0.0.1'
    Port = 5556
    Camera = 'navcam'
    Bodies = 'body'
    PixelClass = 'uint16'
    ImageSize = [1024 1024]
    Exposure_s = 0
    Seed = 0
    SampleTime = 0.1
    Timeout = 10
    Deadline_s = 0
  end

  properties (Access = private)
    Client = []
    Settings
    FrameCount = 0
  end

  methods
    function self = GlRenderBlock(varargin)
      setProperties(self, nargin, varargin{:});
    end
  end

  methods (Access = protected)
    function validatePropertiesImpl(self)
      self.settings_now();
    end

    function setupImpl(self, varargin)
      self.Settings = self.settings_now();
      self.FrameCount = 0;
      self.Client = GlRenderClient(self.Host, self.Port, 'Timeout', self.Timeout);
    end

    function [image, facts] = stepImpl(self, r_sun_inertial_m, spacecraft, bodies)
      % In Simulink the time is the simulation's; called from MATLAB, the frames count it.
      t_s = getCurrentTime(self);
      if isempty(t_s)
        t_s = self.FrameCount * self.SampleTime;
      end
      state = glr_state(strsplit(self.Bodies, ','), t_s, r_sun_inertial_m, spacecraft, bodies);
      [image, facts] = glr_block_image(self.Client, self.Settings, state, self.FrameCount);
      self.FrameCount = self.FrameCount + 1;
    end

    function releaseImpl(self)
      if ~isempty(self.Client)
        self.Client.close();
        self.Client = [];
      end
    end

    function count = getNumInputsImpl(~)
      count = 3;
    end

    function varargout = getInputNamesImpl(~)
      varargout = {'r_sun_inertial_m', 'spacecraft', 'bodies'};
    end

    function count = getNumOutputsImpl(~)
      count = 2;
    end

    function varargout = getOutputNamesImpl(~)
      varargout = {'image', 'facts'};
    end

    function varargout = getOutputSizeImpl(self)
      varargout = {self.ImageSize, [4 1]};
    end

    function varargout = getOutputDataTypeImpl(self)
      varargout = {self.PixelClass, 'double'};
    end

    function varargout = isOutputComplexImpl(~)
      varargout = {false, false};
    end

    function varargout = isOutputFixedSizeImpl(~)
      varargout = {true, true};
    end

    function sample_time = getSampleTimeImpl(self)
      sample_time = createSampleTime(self, 'Type', 'Discrete', 'SampleTime', self.SampleTime);
    end
  end

  methods (Access = private)
    function settings = settings_now(self)
      settings = glr_settings({self.Host, self.Port, self.Camera, self.Bodies, self.PixelClass, self.ImageSize, ...
                               self.Exposure_s, self.Seed, self.SampleTime, self.Timeout, self.Deadline_s});
    end
  end

  methods (Static, Access = protected)
    function mode = getSimulateUsingImpl()
      mode = 'Interpreted execution';
    end

    function yes = showSimulateUsingImpl()
      yes = false;
    end
  end
end
