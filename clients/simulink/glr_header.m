function [header, kept] = glr_header(bytes, kept)
%GLR_HEADER  A reply's header as far as `arrays`: v, op, id, client, ok, arrays, and `shared` where it is.
%   kept: [] at first, then what the last call gave back. Headers of like requests differ in `id` and `shared` alone: of
%   one that begins as the last did only these are read. Errors: glrender:protocol.
  if isempty(kept)
    kept = struct('header', [], 'before', [], 'after', [], 'place', []);
  end
  at = 2 + 2 * (bytes(1) == 222);
  place = [];
  if numel(bytes) > at + 14 && all(bytes(at:at + 6) == [166 115 104 97 114 101 100])  % 'shared'
    [place, at, kept.place] = place_of(bytes, at + 7, kept.place);
  end
  from = at + numel(kept.before);
  to = from + numel(kept.after) + 2;
  % Three bytes of an id, from 256 to 65535; others are read at length.
  if ~isempty(kept.header) && numel(bytes) >= to && bytes(from) == 205 ...
      && all(bytes(at:from - 1) == kept.before) && all(bytes(from + 3:to) == kept.after)
    header = kept.header;
    header.id = 256 * double(bytes(from + 1)) + double(bytes(from + 2));
  else
    [header, last] = glr_unpack(bytes, 'arrays');
    from = at + 16;  % behind v, op, and the key of id
    if last > from + 3 && strcmp(header.op, 'render') && bytes(from) == 205
      [kept.header, kept.before, kept.after] = deal(header, bytes(at:from - 1), bytes(from + 3:last - 1));
      if ~isempty(place)
        kept.header = rmfield(header, 'shared');
      end
    end
  end
  if ~isempty(place)
    header.shared = place;
  end
end

function [place, at, kept] = place_of(bytes, at, kept)
  % The map of `shared`, and what comes behind it. Of places for like frames only the name and the number differ.
  if ~isempty(kept)
    [place, next] = like(bytes, at, kept);
    if ~isempty(place)
      at = next;
      return
    end
  end
  start = at;
  [header, at] = glr_unpack(bytes, 'shared');
  place = header.shared;
  name_at = start + 7 + (bytes(start + 6) == 217);  % behind the map's head, the key 'name', and the head of a text
  number_at = name_at + numel(place.name) + 7;
  kept = struct('place', place, 'head', bytes(start:name_at - 1), 'tail', []);
  if number_at < at
    kept.tail = bytes(number_at + 1 + width_of(bytes(number_at)):at - 1);
    if ~isequal(like(bytes, start, kept), place)
      kept = [];  % in another order than the server's
    end
  end
end

function [place, next] = like(bytes, at, kept)
  name_at = at + numel(kept.head);
  key_at = name_at + numel(kept.place.name);
  place = [];
  next = 0;
  if numel(bytes) < key_at + 7
    return
  end
  width = width_of(bytes(key_at + 7));
  tail_at = key_at + 8 + width;
  next = tail_at + numel(kept.tail);
  if numel(bytes) >= next && all(bytes(at:name_at - 1) == kept.head) && all(bytes(tail_at:next - 1) == kept.tail) ...
      && all(bytes(key_at:key_at + 6) == [166 110 117 109 98 101 114])  % 'number'
    place = kept.place;
    place.name = char(bytes(name_at:key_at - 1));
    place.number = double(bytes(key_at + 7));
    if width > 0
      place.number = 256 .^ (width - 1:-1:0) * double(bytes(key_at + 8:tail_at - 1)).';
    end
  end
end

function width = width_of(code)
  % Bytes of an integer behind its first.
  width = 0;
  if code > 203 && code < 208
    width = 2 ^ (double(code) - 204);
  end
end
