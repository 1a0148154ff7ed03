function out = recorded(varargin)
  % Appends a call to the record, or returns it (no argument) or clears it ('clear').
  persistent calls
  if isempty(calls)
    calls = {};
  end
  out = calls;
  if numel(varargin) == 1 && ischar(varargin{1}) && strcmp(varargin{1}, 'clear')
    calls = {};
  elseif numel(varargin) > 0
    calls{end + 1} = varargin;
  end
end
