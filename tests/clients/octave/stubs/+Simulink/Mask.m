classdef Mask < handle
  properties
    Block
  end
  methods (Static)
    function mask = create(block)
      mask = Simulink.Mask();
      mask.Block = block;
    end
  end
  methods
    function addParameter(self, varargin)
      recorded('addParameter', self.Block, varargin{:});
    end
  end
end
