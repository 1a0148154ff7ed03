function bytes = glr_pack(value)
%GLR_PACK  MessagePack bytes (uint8 row) of a MATLAB value.
%   struct (1 x 1) and containers.Map     map
%   cell                                  list
%   char row                              text, UTF-8
%   double, single: 1 x 1                 float64
%   integer class: 1 x 1                  integer
%   numeric row or column                 list
%   numeric matrix                        list of its rows
%   logical 1 x 1                         true or false
%   struct('bin', uint8 row)              bytes
%   []                                    nil
%   Errors: glrender:pack.
  if isstruct(value) && numel(value) == 1
    names = fieldnames(value);
    if isequal(names, {'bin'})
      bytes = bin_bytes(value.bin);
      return
    end
    chunks = cell(1, 2 * numel(names));
    for k = 1:numel(names)
      name = names{k};
      if numel(name) < 32
        chunks{2 * k - 1} = [uint8(160 + numel(name)), uint8(name)];
      else
        chunks{2 * k - 1} = text_bytes(name);
      end
      entry = value.(name);
      count = numel(entry);
      % The commonest values here, not by a call of their own: calls are what the time goes into.
      if isa(entry, 'double') && count > 0 && count < 16 && count == max(size(entry)) && isreal(entry)
        raw = zeros(9, count, 'uint8');
        raw(1, :) = 203;
        raw(9:-1:2, :) = reshape(typecast(entry(:), 'uint8'), 8, count);
        if count > 1
          chunks{2 * k} = [uint8(144 + count), raw(:).'];
        else
          chunks{2 * k} = raw.';
        end
      elseif ischar(entry) && count < 32 && count == size(entry, 2) && all(entry < 128)
        chunks{2 * k} = [uint8(160 + count), uint8(entry)];
      else
        chunks{2 * k} = glr_pack(entry);
      end
    end
    bytes = [head(128, 222, numel(names), 16), chunks{:}];
  elseif isa(value, 'containers.Map')
    names = keys(value);
    chunks = cell(1, 2 * numel(names));
    for k = 1:numel(names)
      chunks{2 * k - 1} = text_bytes(names{k});
      chunks{2 * k} = glr_pack(value(names{k}));
    end
    bytes = [head(128, 222, numel(names), 16), chunks{:}];
  elseif iscell(value)
    chunks = cell(1, numel(value));
    for k = 1:numel(value)
      chunks{k} = glr_pack(value{k});
    end
    bytes = [head(144, 220, numel(value), 16), chunks{:}];
  elseif ischar(value)
    if size(value, 1) > 1
      error('glrender:pack', 'text must be a row');
    end
    bytes = text_bytes(value);
  elseif isempty(value) && isnumeric(value)
    bytes = uint8(192);
  elseif isnumeric(value) && ~isreal(value)
    error('glrender:pack', 'numbers must be real');
  elseif (isnumeric(value) || islogical(value)) && numel(value) == 1
    bytes = scalar_bytes(value);
  elseif isnumeric(value) && ndims(value) == 2 && any(size(value) == 1)
    if isfloat(value)
      bytes = [head(144, 220, numel(value), 16), float_bytes(value)];
    else
      bytes = glr_pack(num2cell(value));
    end
  elseif isnumeric(value) && ndims(value) == 2
    rows = cell(1, size(value, 1));
    for k = 1:size(value, 1)
      rows{k} = glr_pack(value(k, :));
    end
    bytes = [head(144, 220, numel(rows), 16), rows{:}];
  else
    error('glrender:pack', 'a %s of this size cannot be sent', class(value));
  end
end

function bytes = scalar_bytes(value)
  if islogical(value)
    bytes = uint8(194 + value);
  elseif isfloat(value)
    bytes = float_bytes(value);
  elseif value >= 0
    if value < 128
      bytes = uint8(value);
    elseif value < 256
      bytes = [uint8(204), uint8(value)];
    else
      bytes = [uint8(207), big_endian(uint64(value))];
    end
  elseif value >= -32
    bytes = typecast(int8(value), 'uint8');
  else
    bytes = [uint8(211), big_endian(int64(value))];
  end
end

function bytes = float_bytes(values)
  % Each number is 203 and eight bytes, the most significant first.
  parts = reshape(typecast(reshape(double(values), 1, []), 'uint8'), 8, []);
  bytes = zeros(9, size(parts, 2), 'uint8');
  bytes(1, :) = 203;
  bytes(2:9, :) = parts(8:-1:1, :);
  bytes = bytes(:).';
end

function bytes = text_bytes(text)
  if any(text > 127)
    utf8 = reshape(unicode2native(text, 'UTF-8'), 1, []);
  else
    utf8 = uint8(text);
  end
  if numel(utf8) < 32
    bytes = [uint8(160 + numel(utf8)), utf8];
  elseif numel(utf8) < 256
    bytes = [uint8([217, numel(utf8)]), utf8];
  else
    bytes = [uint8(219), big_endian(uint32(numel(utf8))), utf8];
  end
end

function bytes = bin_bytes(raw)
  count = numel(raw);
  if count < 256
    bytes = [uint8([196, count]), raw];
  elseif count < 65536
    bytes = [uint8(197), big_endian(uint16(count)), raw];
  else
    bytes = [uint8(198), big_endian(uint32(count)), raw];
  end
end

function bytes = head(short, long, count, limit)
  if count < limit
    bytes = uint8(short + count);
  elseif count < 65536
    bytes = [uint8(long), big_endian(uint16(count))];
  else
    bytes = [uint8(long + 1), big_endian(uint32(count))];
  end
end

function bytes = big_endian(value)
  bytes = typecast(value, 'uint8');
  bytes = bytes(end:-1:1);
end
