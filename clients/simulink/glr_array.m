function value = glr_array(entry, bytes)
%GLR_ARRAY  The array of a message part.
%   entry: its description in the header's `arrays` (dtype, shape, order); bytes: uint8, or uint64 of eight each.
%   The result has the shape sent, row 1 on top. Errors: glrender:protocol.
  names = {'uint8', 'uint16', 'int32', 'float32', 'float64'};
  classes = {'uint8', 'uint16', 'int32', 'single', 'double'};
  widths = [1 2 4 4 8];
  which = find(strcmp(entry.dtype, names));
  shape = entry.shape;
  count = numel(bytes);
  if isa(bytes, 'uint64')
    count = 8 * count;
  end
  if isempty(which) || count ~= prod(shape) * widths(which)
    error('glrender:protocol', 'array %s: %d bytes are no %s of %s', entry.name, count, mat2str(shape), entry.dtype);
  end
  flat = bytes;
  if ~isa(bytes, classes{which})
    flat = typecast(bytes, classes{which});  % a copy, also where it changes nothing
  end
  if numel(shape) == 1
    value = reshape(flat, [], 1);
  elseif entry.order == 'F'
    value = reshape(flat, shape);
  else
    value = permute(reshape(flat, shape(end:-1:1)), numel(shape):-1:1);
  end
end
