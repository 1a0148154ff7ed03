classdef System < handle
  % A stand-in for matlab.System: the call order and the checks that Simulink's block makes. MATLAB calls
  % step by obj(...); Octave's classdef cannot, hence step().
  properties (Access = private)
    IsSetUp = false
    Time = []
  end
  methods
    function varargout = step(self, varargin)
      check(numel(varargin) == self.getNumInputsImpl(), 'wrong number of inputs');
      if ~self.IsSetUp
        self.validatePropertiesImpl();
        self.setupImpl(varargin{:});
        self.IsSetUp = true;
      end
      varargout = cell(1, 1);
      [varargout{:}] = self.stepImpl(varargin{:});
      % What the block has declared to Simulink must be what comes.
      check(isequal(size(varargout{1}), self.getOutputSizeImpl()), 'size of the output');
      check(isa(varargout{1}, self.getOutputDataTypeImpl()), 'class of the output');
      check(isreal(varargout{1}) && ~self.isOutputComplexImpl() && self.isOutputFixedSizeImpl(), 'output');
    end
    function release(self)
      if self.IsSetUp
        self.releaseImpl();
        self.IsSetUp = false;
      end
    end
    function setProperties(self, count, varargin)
      check(count == numel(varargin) && mod(count, 2) == 0, 'names and values come in pairs');
      for k = 1:2:count
        self.(varargin{k}) = varargin{k + 1};
      end
    end
    function t = getCurrentTime(self)
      t = self.Time;
    end
    function simulate_time(self, t)
      self.Time = t;
    end
    function s = createSampleTime(~, varargin)
      s = struct(varargin{:});
    end
    function s = declared(self)
      names = cell(1, self.getNumInputsImpl());
      [names{:}] = self.getInputNamesImpl();
      s = struct('inputs', {names}, 'output', self.getOutputNamesImpl(), 'sample_time', self.getSampleTimeImpl());
    end
  end
  methods (Access = protected)
    function setupImpl(~, varargin)
    end
    function varargout = stepImpl(~, varargin)
      varargout = {};
    end
    function releaseImpl(~)
    end
    function validatePropertiesImpl(~)
    end
    function n = getNumInputsImpl(~)
      n = 1;
    end
    function varargout = getInputNamesImpl(~)
      varargout = {''};
    end
    function n = getOutputNamesImpl(~)
      n = '';
    end
    function d = getOutputSizeImpl(~)
      d = [1 1];
    end
    function n = getOutputDataTypeImpl(~)
      n = 'double';
    end
    function y = isOutputComplexImpl(~)
      y = false;
    end
    function y = isOutputFixedSizeImpl(~)
      y = false;
    end
    function s = getSampleTimeImpl(~)
      s = [];
    end
  end
end
