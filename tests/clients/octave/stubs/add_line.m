function add_line(varargin)
  recorded('add_line', varargin{:});
end
