function new_system(varargin)
  recorded('new_system', varargin{:});
end
