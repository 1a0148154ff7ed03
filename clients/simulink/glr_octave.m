function glr_octave()
%GLR_OCTAVE  Make GNU Octave ready for the client, once: its tcpclient, and memory that frames are read into.
  persistent is_ready
  if isempty(is_ready)
    pkg('load', 'instrument-control');
    % When 31 MiB are freed glibc keeps what is freed later, up to twice as much, where it gave it back to the system and
    % frames were read into new memory: 4 MiB take 4 ms instead of 7.
    kept = zeros(1, 31 * 2 ^ 20, 'uint8'); %#ok<NASGU>
    clear kept
    is_ready = true;
  end
end
