function check(is_true, varargin)
  % Fails the script, with the text given.
  if ~(isscalar(is_true) && is_true)
    error('check:failed', varargin{:});
  end
end
