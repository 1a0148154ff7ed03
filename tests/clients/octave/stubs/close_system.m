function close_system(varargin)
  recorded('close_system', varargin{:});
end
