function entry = glr_block_store(handle, entry)
%GLR_BLOCK_STORE  What a Level-2 S-function keeps between steps: DWork holds numbers only.
%   glr_block_store(handle, entry) keeps, glr_block_store(handle) gets ([] if there is none),
%   glr_block_store(handle, []) forgets. handle: the block's, a number.
  persistent kept
  if isempty(kept)
    kept = containers.Map('KeyType', 'double', 'ValueType', 'any');
  end
  if nargin > 1
    if isempty(entry)
      if isKey(kept, handle)
        remove(kept, handle);
      end
    else
      kept(handle) = entry;
    end
  elseif isKey(kept, handle)
    entry = kept(handle);
  else
    entry = [];
  end
end
