function add_block(varargin)
  recorded('add_block', varargin{:});
end
