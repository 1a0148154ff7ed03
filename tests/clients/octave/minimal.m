function bytes = minimal(number)
  % The shortest MessagePack of an integer >= 0, as a server packs it.
  classes = {'uint8', 'uint16', 'uint32', 'uint64'};
  k = 1 + sum(number > [255, 65535, 2 ^ 32 - 1]);
  bytes = typecast(cast(number, classes{k}), 'uint8');
  bytes = [uint8(203 + k), bytes(end:-1:1)];
  if number < 128
    bytes = uint8(number);
  end
end
