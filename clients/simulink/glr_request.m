function [bytes, kept] = glr_request(kept, id, pairs, state)
%GLR_REQUEST  A request as it goes over TCP (uint8 row): the fields v and id, the pairs, and the state unless it is [].
%   pairs: {NAME, VALUE, ...}. kept: [] at first, then what the last call gave back: texts that are the same, and states
%   with the same fields, are not packed again. Errors: glrender:pack.
  if isempty(kept)
    kept = struct('pairs', {{}}, 'chunks', {{}}, 'form', []);
  end
  is_new = true(size(pairs));
  if numel(pairs) == numel(kept.pairs)
    is_new = ~strcmp(pairs, kept.pairs);  % what is no text is never the same
  else
    kept.chunks = cell(size(pairs));
  end
  for k = find(is_new)
    kept.chunks{k} = glr_pack(pairs{k});
  end
  kept.pairs = pairs;
  state_bytes = zeros(1, 0, 'uint8');
  count = 2 + numel(pairs) / 2;
  if ~isempty(state)
    [state_bytes, kept.form] = glr_pack_like(state, kept.form);
    state_bytes = [uint8([165 115 116 97 116 101]), state_bytes];  % 'state'
    count = count + 1;
  end
  number = typecast(uint64(id), 'uint8');
  % A map of up to 65535 pairs; v: 1; id: a uint64.
  bytes = glr_frame([uint8([222 0 count 161 118 1 162 105 100 207]), number(8:-1:1), kept.chunks{:}, state_bytes]);
end
