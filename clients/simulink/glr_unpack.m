function [value, last] = glr_unpack(bytes, last_key)
%GLR_UNPACK  The MATLAB value of MessagePack bytes (uint8 row).
%   A map becomes a struct (a key that is no MATLAB name is made one: other characters to '_', 'x' before a
%   leading digit), a list of numbers a row vector, any other list a cell row, an integer a double, or
%   int64/uint64 beyond 2^53; nil becomes [], binary a uint8 row.
%   [value, next] = glr_unpack(bytes, KEY) reads an outermost map up to this key; what begins at `next` is left unread.
%   Errors: glrender:protocol, for bytes that are no message or more than one.
  count = numel(bytes);
  try
    if nargin > 1 && bytes(1) > 127 && bytes(1) < 144
      [value, last, is_whole] = map(bytes, 2, double(bytes(1)) - 128, last_key);
    elseif nargin > 1 && bytes(1) == 222
      [value, last, is_whole] = map(bytes, 4, 256 * double(bytes(2)) + double(bytes(3)), last_key);
    else
      [value, last] = item(bytes, 1);
      is_whole = true;
    end
  catch problem
    if strcmp(problem.identifier, 'glrender:protocol')
      rethrow(problem);
    end
    error('glrender:protocol', 'MessagePack ends too early: %d bytes', count);
  end
  if is_whole && last ~= count + 1
    error('glrender:protocol', 'MessagePack of %d bytes has %d bytes', last - 1, count);
  end
end

function [value, at] = item(bytes, at)
  code = double(bytes(at));
  at = at + 1;
  if code < 128
    value = code;
  elseif code < 144
    [value, at] = map(bytes, at, code - 128);
  elseif code < 160
    [value, at] = list(bytes, at, code - 144);
  elseif code < 192
    value = text(bytes(at:at + code - 161));
    at = at + code - 160;
  elseif code >= 224
    value = code - 256;
  else
    switch code
      case 203
        value = typecast(bytes(at + 7:-1:at), 'double');
        at = at + 8;
      case 202
        value = double(typecast(bytes(at + 3:-1:at), 'single'));
        at = at + 4;
      case 192
        value = [];
      case 194
        value = false;
      case 195
        value = true;
      case {204, 205, 206, 207}
        classes = {'uint8', 'uint16', 'uint32', 'uint64'};
        [value, at] = whole(bytes, at, classes{code - 203}, 2 ^ (code - 204));
      case {208, 209, 210, 211}
        classes = {'int8', 'int16', 'int32', 'int64'};
        [value, at] = whole(bytes, at, classes{code - 207}, 2 ^ (code - 208));
      case {217, 218, 219}
        [count, at] = size_of(bytes, at, code - 217);
        value = text(bytes(at:at + count - 1));
        at = at + count;
      case {196, 197, 198}
        [count, at] = size_of(bytes, at, code - 196);
        value = bytes(at:at + count - 1);
        at = at + count;
      case {220, 221}
        [count, at] = size_of(bytes, at, code - 219);
        [value, at] = list(bytes, at, count);
      case {222, 223}
        [count, at] = size_of(bytes, at, code - 221);
        [value, at] = map(bytes, at, count);
      otherwise
        error('glrender:protocol', 'MessagePack type %d is not in the protocol', code);
    end
  end
end

function [value, at, is_whole] = map(bytes, at, count, last_key)
  value = struct();
  is_whole = true;
  for k = 1:count
    code = double(bytes(at));
    if code >= 160 && code < 192
      % Nearly every key: a short text.
      name = char(bytes(at + 1:at + code - 160));
      at = at + code - 159;
    else
      [name, at] = item(bytes, at);
      if ~ischar(name)
        error('glrender:protocol', 'a map must have text keys');
      end
    end
    % The commonest values here, not by a call of their own: calls are what the time goes into.
    code = double(bytes(at));
    if code < 128
      entry = code;
      at = at + 1;
    elseif code == 203
      entry = typecast(bytes(at + 8:-1:at + 1), 'double');
      at = at + 9;
    elseif code >= 160 && code < 192 && all(bytes(at + 1:at + code - 160) < 128)
      entry = char(bytes(at + 1:at + code - 160));
      at = at + code - 159;
    else
      [entry, at] = item(bytes, at);
    end
    if ~isvarname(name)
      name = field_name(name);
    end
    value.(name) = entry;
    if nargin > 3 && strcmp(name, last_key)
      is_whole = k == count;
      return
    end
  end
end

function name = field_name(name)
  name = regexprep(name, '\W', '_');
  if isempty(regexp(name, '^[A-Za-z]', 'once'))
    name = ['x', name];
  end
end

function [value, at] = list(bytes, at, count)
  if count > numel(bytes) - at + 1
    error('glrender:protocol', 'a list of %d entries in %d bytes', count, numel(bytes));
  end
  if count > 0 && all(bytes(at:at + count - 1) < 128)
    value = double(bytes(at:at + count - 1));
    at = at + count;
    return
  end
  value = cell(1, count);
  is_numbers = count > 0;
  for k = 1:count
    [value{k}, at] = item(bytes, at);
    is_numbers = is_numbers && isa(value{k}, 'double') && isscalar(value{k});
  end
  if is_numbers
    value = [value{:}];
  end
end

function value = text(bytes)
  if any(bytes > 127)
    value = native2unicode(reshape(bytes, 1, []), 'UTF-8');
  else
    value = char(bytes);
  end
end

function [value, at] = whole(bytes, at, kind, width)
  value = typecast(bytes(at + width - 1:-1:at), kind);
  at = at + width;
  if width < 8 || abs(double(value)) < 2 ^ 53
    value = double(value);
  end
end

function [count, at] = size_of(bytes, at, power)
  width = 2 ^ power;
  count = 0;
  for k = 0:width - 1
    count = 256 * count + double(bytes(at + k));
  end
  at = at + width;
end
