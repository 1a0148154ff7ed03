function [bytes, form] = glr_pack_like(value, form)
%GLR_PACK_LIKE  MessagePack bytes (uint8 row) of a struct, sooner where it has the fields and sizes of the one before.
%   form: [] at first, then what the last call gave back: the bytes, and where the numbers stand in them. Numbers of
%   structs alike (in structs, real double vectors and nothing else) are put there; any other value is glr_pack's, which
%   takes several times as long. The order of fields is that of the first. Errors: glrender:pack.
  if ~isempty(form)
    try
      numbers = numbers_of(value, form);
    catch
      numbers = [];  % other fields
    end
    if ~isempty(numbers)
      parts = reshape(typecast(numbers, 'uint8'), 8, []);
      bytes = form.bytes;
      bytes(form.places) = parts(8:-1:1, :);  % the most significant first
      return
    end
  end
  bytes = glr_pack(value);
  form = form_of(value, bytes);
end

function numbers = numbers_of(value, form)
  % All numbers, a column; [] where one is missing, or no double.
  numbers = [];
  leaves = leaves_of(value, form.node);
  counts = form.counts;
  if numel(leaves) ~= numel(counts) || ~all(cellfun('isclass', leaves, 'double') & cellfun('isreal', leaves))
    return
  end
  for k = find(cellfun('size', leaves, 1) ~= counts).'
    leaves{k} = leaves{k}.';
  end
  if all(cellfun('size', leaves, 1) == counts & cellfun('prodofsize', leaves) == counts)
    numbers = vertcat(leaves{:});
  end
end

function leaves = leaves_of(value, node)
  % What is no struct, a column in the order of the sample's fields; an error if the fields are not the sample's.
  leaves = struct2cell([node.sample; value]);
  leaves = leaves(:, 2);
  for k = node.nested
    leaves = [leaves(1:k - 1); leaves_of(leaves{k}, node.children{k}); leaves(k + 1:end)];
  end
end

function form = form_of(value, bytes)
  form = [];
  if ~isstruct(value) || numel(value) ~= 1
    return
  end
  form = struct('bytes', bytes, 'places', []);
  form.node = node_of(value);
  leaves = leaves_of(value, form.node);
  form.counts = cellfun('prodofsize', leaves);
  if isempty(leaves) || any(form.counts == 0) || isempty(numbers_of(value, form))
    form = [];
    return
  end
  % Two numbers without an equal byte: where the messages differ a number stands.
  ones = glr_pack(filled(value, typecast(uint8(1:8), 'double')));
  form.places = reshape(find(glr_pack(filled(value, 0)) ~= ones), 8, []);
end

function node = node_of(sample)
  % nested: which of the fields are structs, the last first.
  values = struct2cell(sample);
  is_nested = cellfun('isclass', values, 'struct') & cellfun('prodofsize', values) == 1;
  node = struct('sample', sample, 'nested', flipud(find(is_nested)).', 'children', {cell(size(values))});
  for k = node.nested
    node.children{k} = node_of(values{k});
  end
end

function value = filled(value, number)
  for name = fieldnames(value).'
    entry = value.(name{1});
    if isstruct(entry)
      value.(name{1}) = filled(entry, number);
    else
      value.(name{1}) = repmat(number, 1, numel(entry));
    end
  end
end
