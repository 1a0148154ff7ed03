classdef FakeBlock < handle
  % A stand-in for Simulink's run-time object (Simulink.MSFcnRunTimeBlock): takes a Level-2 S-function through a run and
  % makes the checks that Simulink would: legal names, dialogue parameters, sizes and classes of signals.
  properties
    NumDialogPrms = -1
    DialogPrmsTunable = {}
    DialogPrm
    NumInputPorts = 0
    NumOutputPorts = 0
    InputPort
    OutputPort
    SampleTimes = []
    SimStateCompliance = ''
    CurrentTime = 0
    BlockHandle
    Methods = struct()
    Given
  end
  properties (Constant)
    PortFields = {'Data', 'DatatypeID', 'Complexity', 'Dimensions', 'SamplingMode', 'DirectFeedthrough'}
    Legal = {'CheckParameters', 'SetInputPortSamplingMode', 'SetInputPortDimensions', 'SetOutputPortDimensions', ...
             'SetInputPortDataType', 'SetOutputPortDataType', 'PostPropagationSetup', 'InitializeConditions', 'Start', ...
             'Outputs', 'Update', 'Derivatives', 'Terminate', 'ProcessParameters', 'Enable', 'Disable'}
  end
  methods
    function self = FakeBlock(handle, parameters)
      self.BlockHandle = handle;
      self.Given = numel(parameters);
      self.DialogPrm = struct('Data', parameters);
    end
    function set.NumInputPorts(self, count)
      self.NumInputPorts = count;
      self.InputPort = FakeBlock.ports(count);
    end
    function set.NumOutputPorts(self, count)
      self.NumOutputPorts = count;
      self.OutputPort = FakeBlock.ports(count);
    end
    function SetPreCompInpPortInfoToDynamic(self)
      check(self.NumInputPorts > 0, 'ports first');
    end
    function SetPreCompOutPortInfoToDynamic(self)
      check(self.NumOutputPorts > 0, 'ports first');
    end
    function SetAccelRunOnTLC(~, is)
      check(islogical(is), 'SetAccelRunOnTLC takes true or false');
    end
    function RegBlockMethod(self, name, method)
      check(any(strcmp(name, FakeBlock.Legal)), '%s is no block method', name);
      check(isa(method, 'function_handle'), '%s must be a function', name);
      self.Methods.(name) = method;
    end
    function set_up(self, s_function)
      s_function(self);
      check(self.NumDialogPrms == self.Given, '%d parameters declared, %d given', self.NumDialogPrms, self.Given);
      check(numel(self.DialogPrmsTunable) == self.NumDialogPrms, 'DialogPrmsTunable');
      check(all(ismember(self.DialogPrmsTunable, {'Tunable', 'Nontunable', 'SimOnlyTunable'})), 'DialogPrmsTunable');
      check(isequal(sort(fieldnames(self.InputPort)), sort(FakeBlock.PortFields.')), 'a field that ports have not');
      check(isequal(sort(fieldnames(self.OutputPort)), sort(FakeBlock.PortFields.')), 'a field that ports have not');
      check(numel(self.InputPort) == self.NumInputPorts && numel(self.OutputPort) == self.NumOutputPorts, 'ports');
      check(isequal(size(self.SampleTimes), [1 2]), 'SampleTimes');
      check(any(strcmp(self.SimStateCompliance, {'DefaultSimState', 'HasNoSimState', 'DisallowSimState', 'UnknownSimState'})), ...
            'SimStateCompliance');
    end
    function [image, facts] = output_at(self, t, varargin)
      check(numel(varargin) == self.NumInputPorts, 'a value for each port');
      for k = 1:numel(varargin)
        check(self.InputPort(k).DatatypeID == 0 && isa(varargin{k}, 'double'), 'inputs are double');
        check(numel(varargin{k}) == prod(self.InputPort(k).Dimensions), 'width of input %d', k);
        check(self.InputPort(k).DirectFeedthrough, 'an input read in Outputs needs direct feedthrough');
        self.InputPort(k).Data = varargin{k}(:);
      end
      self.CurrentTime = t;
      self.call('Outputs');
      image = self.OutputPort(1).Data;
      classes = {'double', 'single', 'int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32', 'boolean'};
      check(isa(image, classes{self.OutputPort(1).DatatypeID + 1}), 'class of the output');
      check(isequal(size(image), self.OutputPort(1).Dimensions), 'size of the output');
      facts = self.OutputPort(2).Data;
      check(isa(facts, 'double') && numel(facts) == self.OutputPort(2).Dimensions && self.OutputPort(2).DatatypeID == 0, 'facts');
    end
    function call(self, name)
      method = self.Methods.(name);
      method(self);
    end
  end
  methods (Static)
    function p = ports(count)
      p = repmat(struct('Data', [], 'DatatypeID', -1, 'Complexity', '', 'Dimensions', -1, 'SamplingMode', '', ...
                        'DirectFeedthrough', false), 1, count);
    end
  end
end
