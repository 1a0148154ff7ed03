function pairs = glr_compare_pairs(pairs)
%GLR_COMPARE_PAIRS  Options of GlRenderClient.render with the frame of `compare` as the wire has it (docs/protocol.md).
%   {..., 'compare', frame, 'blur_px', 2, 'robust', true} becomes {..., 'compare', struct(pixels, dtype, shape, ...)}.
  names = pairs(1:2:end);
  at = find(strcmp(names, 'compare'));
  if isempty(at)
    return
  end
  frame = pairs{2 * at(end)};
  dtype = class(frame);
  known = {'uint8', 'uint16', 'single', 'double'; 'uint8', 'uint16', 'float32', 'float64'};
  which = strcmp(known(1, :), dtype);
  if ~any(which) || ndims(frame) ~= 2
    error('glrender:argument', 'compare must be a matrix of uint8, uint16, single or double, got %s', dtype);
  end
  raw = reshape(frame.', 1, []);  % row by row
  compare.pixels = struct('bin', reshape(typecast(raw, 'uint8'), 1, []));
  compare.dtype = known{2, which};
  compare.shape = {uint32(size(frame, 1)), uint32(size(frame, 2))};
  moved = false(size(names));
  for name = {'blur_px', 'robust'}
    given = find(strcmp(names, name{1}));
    if ~isempty(given)
      compare.(name{1}) = pairs{2 * given(end)};
      moved(given) = true;
    end
  end
  pairs{2 * at(end)} = compare;
  moved(at(1:end - 1)) = true;
  pairs = reshape(pairs, 2, []);
  pairs = reshape(pairs(:, ~moved), 1, []);
end
