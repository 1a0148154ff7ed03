function set_param(varargin)
  recorded('set_param', varargin{:});
end
