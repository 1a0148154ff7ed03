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
      n = self.getNumOutputsImpl();
      [varargout, sizes, types, are_complex, are_fixed] = deal(cell(1, n));
      [varargout{:}] = self.stepImpl(varargin{:});
      % What the block has declared to Simulink must be what comes.
      [sizes{:}] = self.getOutputSizeImpl();
      [types{:}] = self.getOutputDataTypeImpl();
      [are_complex{:}] = self.isOutputComplexImpl();
      [are_fixed{:}] = self.isOutputFixedSizeImpl();
      for k = 1:n
        check(isequal(size(varargout{k}), sizes{k}), 'size of an output');
        check(isa(varargout{k}, types{k}), 'class of an output');
        check(isreal(varargout{k}) && ~are_complex{k} && are_fixed{k}, 'output');
      end
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
      outputs = cell(1, self.getNumOutputsImpl());
      [outputs{:}] = self.getOutputNamesImpl();
      s = struct('inputs', {names}, 'outputs', {outputs}, 'sample_time', self.getSampleTimeImpl());
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
    function n = getNumOutputsImpl(~)
      n = 1;
    end
    function varargout = getOutputNamesImpl(~)
      varargout = {''};
    end
    function varargout = getOutputSizeImpl(~)
      varargout = {[1 1]};
    end
    function varargout = getOutputDataTypeImpl(~)
      varargout = {'double'};
    end
    function varargout = isOutputComplexImpl(~)
      varargout = {false};
    end
    function varargout = isOutputFixedSizeImpl(~)
      varargout = {false};
    end
    function s = getSampleTimeImpl(~)
      s = [];
    end
  end
end
