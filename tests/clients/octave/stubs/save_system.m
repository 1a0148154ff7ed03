function save_system(varargin)
  recorded('save_system', varargin{:});
end
