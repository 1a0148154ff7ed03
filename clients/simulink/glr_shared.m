function parts = glr_shared(place)
%GLR_SHARED  The pixels of a reply, read in the memory that a server on this machine wrote them to (Linux).
%   place: `shared` of the reply's header (docs/protocol.md). Each part is a column of uint64, eight bytes a word, or of
%   uint8 where its size is no multiple of eight. {} where the frame is not there any more, or cannot be read.
  parts = cell(1, numel(place.sizes));
  path = ['/dev/shm/', place.name];
  file = -1;
  if ~isempty(regexp(place.name, '^glrender-slot-[0-9a-z-]+$', 'once'))
    file = fopen(path, 'r');
  end
  if file < 0
    parts = {};
    return
  end
  for k = 1:numel(parts)
    fseek(file, place.offsets(k), 'bof');
    if mod(place.sizes(k), 8)
      parts{k} = fread(file, place.sizes(k), '*uint8');
    else
      parts{k} = fread(file, place.sizes(k) / 8, '*uint64');  % four times as fast as by bytes
    end
  end
  fclose(file);
  % The number goes up before the memory is written anew: what was read is whole if it has not.
  file = fopen(path, 'r');
  number = [];
  if file >= 0
    number = fread(file, 1, '*uint64');
    fclose(file);
  end
  if numel(number) ~= 1 || number ~= uint64(place.number)
    parts = {};
  end
end
