function [header_bytes, parts] = glr_receive(socket, timeout_s, where)
%GLR_RECEIVE  The next message of a tcpclient: its first part, and a cell of the others (uint8 rows).
%   where: 'host:port' for messages. Errors: glrender:timeout, glrender:connection, glrender:protocol.
  prefix = exactly(socket, 12, timeout_s, where);  % with the first part's size: every message has one
  n_parts = double(prefix(5)) + 256 * double(prefix(6));
  if ~all(prefix(1:4) == uint8('GLR1')) || n_parts < 1
    error('glrender:protocol', 'the server at %s does not speak GLR1', where);
  end
  rest = 4 * (n_parts - 1);
  header_bytes = exactly(socket, rest + double(typecast(prefix(9:12), 'uint32')), timeout_s, where);
  parts = cell(1, n_parts - 1);
  if n_parts > 1
    sizes = double(typecast(header_bytes(1:rest), 'uint32'));
    header_bytes = header_bytes(rest + 1:end);
    for k = 1:n_parts - 1
      parts{k} = exactly(socket, sizes(k), timeout_s, where);
    end
  end
end

function bytes = exactly(socket, count, timeout_s, where)
  % One read each: chunks of 64 KiB cost three times as much.
  persistent octave_read
  if isempty(octave_read)
    octave_read = '';
    if exist('OCTAVE_VERSION', 'builtin') && exist('__tcpclient_read__') %#ok<EXIST>
      octave_read = '__tcpclient_read__';  % what `read` calls in the end, after 0.3 ms of looking up its timeout
    end
  end
  if count == 0
    bytes = zeros(1, 0, 'uint8');
    return
  end
  try
    if octave_read
      bytes = feval(octave_read, socket, count, 1e3 * timeout_s);
    else
      bytes = reshape(uint8(read(socket, count, 'uint8')), 1, []);  % MATLAB's read gives doubles
    end
  catch problem
    if ~isempty(regexpi([problem.identifier, ' ', problem.message], 'time-?out|timed out', 'once'))
      bytes = zeros(1, 0, 'uint8');  % MATLAB may raise an error where Octave returns less
    else
      error('glrender:connection', 'the connection to %s is lost: %s', where, problem.message);
    end
  end
  if numel(bytes) ~= count
    error('glrender:timeout', ['%s did not answer within %g s: the connection stands, so the server is busy, with ' ...
          'this request or with others before it; give a longer Timeout'], where, timeout_s);
  end
end
