function bytes = from_hex(text)
  bytes = uint8(sscanf(text, '%2x')).';
end
