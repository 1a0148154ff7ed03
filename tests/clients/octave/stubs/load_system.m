function load_system(varargin)
  recorded('load_system', varargin{:});
end
