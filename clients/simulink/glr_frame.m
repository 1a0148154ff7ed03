function bytes = glr_frame(part)
%GLR_FRAME  A message of one part as it goes over TCP: docs/protocol.md. uint8 row in and out.
  bytes = [uint8('GLR1'), uint8([1 0 0 0]), typecast(uint32(numel(part)), 'uint8'), part];
end
