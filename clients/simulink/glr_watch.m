function glr_watch(socket, host, port, timeout_s, progress)
%GLR_WATCH  Tell how far slow frames are until the reply to a request begins to come, asking by another connection.
%   socket: the tcpclient that waits; progress: called with the share done, 0 to 1, about twice a second.
  began = tic();
  due = 0.5;
  other = [];
  while toc(began) < timeout_s && n_waiting(socket) == 0
    pause(0.02);
    if toc(began) < due
      continue
    end
    due = toc(began) + 0.5;
    try
      if isempty(other)
        other = GlRenderClient(host, port, 'Timeout', timeout_s, 'Retries', 0);
      end
      told = other.status();
    catch
      return  % the reply will have the error
    end
    if isfield(told, 'slow_frames') && ~isempty(told.slow_frames)
      progress(max(told.slow_frames));
    end
  end
end

function count = n_waiting(socket)
  try
    count = socket.NumBytesAvailable;
  catch
    count = socket.BytesAvailable;  % before R2020b
  end
end
