classdef GlRenderClient < handle
%GLRENDERCLIENT  Asks a glrender server for frames, over framed TCP; needs no toolbox.
%   client = GlRenderClient()                           127.0.0.1, port 5556 (glrender-server scene.toml --tcp ...)
%   client = GlRenderClient(host, port, 'Timeout', 10, 'Retries', 1, 'SharedMemory', true)
%   reply = client.render(state, 'camera', 'navcam', 'output', 'dn', 'exposure_s', 0.1, 'seed', 7)
%   reply.pixels                                        height x width, row 1 on top
%   client.close()
%
%   `state` is the struct of docs/protocol.md: t_s, r_sun_inertial_m, spacecraft.r_inertial_m,
%   spacecraft.q_from_inertial ([w x y z]), bodies.NAME.r_inertial_m, bodies.NAME.q_from_inertial.
%   A body whose name is no MATLAB name: make `bodies` a containers.Map.
%
%   Errors: glrender:CODE with the codes of docs/protocol.md (glrender:config, glrender:scene, glrender:busy, ...),
%   glrender:timeout, glrender:connection, glrender:protocol, glrender:closed, glrender:argument.

  properties (SetAccess = private)
    Host
    Port
    Timeout   % [s], of each try
    Retries   % further tries after a timeout or a lost connection, each over a new connection
    Name      % of this client; the server answers a repeated request from its last reply
    SharedMemory  % whether frames are read in the memory of a server on this machine; by default on Linux
  end

  properties (Access = private)
    Socket = []
    NextId = 256  % the width of an id on the wire is the same for long
    IsClosed = false
    Progress = []  % of the request under way: called with the share done
    Known = []     % the last reply's first fields, and their bytes before and after its id
  end

  methods
    function self = GlRenderClient(host, port, varargin)
      if nargin < 1
        host = '127.0.0.1';
      end
      if nargin < 2
        port = 5556;
      end
      if strcmp(host, 'localhost')
        host = '127.0.0.1';  % may resolve to IPv6, where no server listens
      end
      self.Host = host;
      self.Port = port;
      is_here = strcmp(host, '127.0.0.1') && exist('/dev/shm', 'dir') == 7;
      options = struct('Timeout', 10, 'Retries', 1, 'SharedMemory', is_here);
      options = GlRenderClient.with_options(options, varargin, fieldnames(options));
      if ~(options.Timeout > 0) || ~(options.Retries >= 0)
        error('glrender:argument', 'Timeout must be > 0 [s] and Retries >= 0');
      end
      self.Timeout = options.Timeout;
      self.Retries = options.Retries;
      self.SharedMemory = logical(options.SharedMemory);
      self.Name = sprintf('matlab-%s', GlRenderClient.unique_text());
      if exist('OCTAVE_VERSION', 'builtin')
        pkg('load', 'instrument-control');
      end
      self.connect();
    end

    function delete(self)
      self.disconnect();
    end

    function close(self)
      %CLOSE  Say goodbye and hang up.
      if ~self.IsClosed && ~isempty(self.Socket)
        try
          self.once(self.packed('close', struct()));
        catch
          % A server that is gone keeps nothing of ours.
        end
      end
      self.disconnect();
      self.IsClosed = true;
    end

    function header = hello(self)
      %HELLO  What the server is: protocol versions, cameras, bodies, products, limits, OpenGL.
      [~, bytes] = self.ask('hello', struct());
      header = glr_unpack(bytes);
    end

    function header = status(self)
      %STATUS  How the server does: uptime_s, requests, errors by code, last_timings_ms.
      [~, bytes] = self.ask('status', struct());
      header = glr_unpack(bytes);
    end

    function header = load_scene(self, scene)
      %LOAD_SCENE  Replace the server's scene, for every client: the struct of a scene file (docs/scene.md).
      [~, bytes] = self.ask('load_scene', struct('scene', scene));
      header = glr_unpack(bytes);
    end

    function reply = render(self, state, varargin)
      %RENDER  One frame.
      %   reply = client.render(state, NAME, VALUE, ...) with the names of docs/protocol.md: camera, output
      %   ('irradiance' or 'dn'), exposure_s, seed, max_error, samples, products (cell of names), roi ([x0 y0 x1 y1],
      %   pixels from 0, one past the last: whole(y0 + 1:y1, x0 + 1:x1)), allow_slow (true, 'raytrace' or 'cycles': who
      %   may draw in seconds or minutes what OpenGL cannot within max_error; give the client a Timeout as long).
      %   'progress', @(share) fprintf('%.0f %%\n', 100 * share) is called about twice a second while a server with
      %   worker processes draws slow frames.
      %   The result is a GlRenderReply: reply.pixels, reply.arrays.PRODUCT, reply.header.
      fields = struct('state', state, 'order', 'F');
      names = [GlRenderClient.frame_options(), GlRenderClient.request_options()];
      fields = GlRenderClient.with_options(fields, varargin, names);
      [arrays, header_bytes] = self.ask_frames(GlRenderClient.with_list(fields));
      reply = GlRenderReply(arrays{1}, header_bytes);
    end

    function replies = render_frames(self, state, frames, varargin)
      %RENDER_FRAMES  Several frames of one state in one request; a cell of GlRenderReply, in their order.
      %   frames: cell of structs with the options of `render`: {struct('camera', 'navcam'), struct('camera', 'wac')}.
      %   15 images and products in all; one frame that is refused refuses all. Then NAME, VALUE of allow_slow, progress.
      if ~iscell(frames) || ~all(cellfun(@(frame) isstruct(frame) && isscalar(frame), frames))
        error('glrender:argument', 'frames must be a cell of structs');
      end
      for k = 1:numel(frames)
        wrong = setdiff(fieldnames(frames{k}), GlRenderClient.frame_options());
        if ~isempty(wrong)
          error('glrender:argument', 'frames{%d}: unknown option %s', k, wrong{1});
        end
        frames{k} = GlRenderClient.with_list(frames{k});
      end
      fields = struct('state', state, 'order', 'F');
      fields.frames = reshape(frames, 1, []);
      fields = GlRenderClient.with_options(fields, varargin, GlRenderClient.request_options());
      [arrays, header_bytes] = self.ask_frames(fields);
      replies = cell(1, numel(frames));
      for k = 1:numel(frames)
        replies{k} = GlRenderReply(arrays{k}, header_bytes, k);
      end
    end

    function reply = range(self, state, directions_camera, varargin)
      %RANGE  Laser ranges along directions (N x 3 unit vectors in the camera's frame), exact against the facets.
      %   reply = client.range(state, directions, 'camera', 'navcam', 'noise', struct('sigma_m', 0.1, 'seed', 1))
      %   reply.arrays: range [m], body_id, facet_id, beam_incidence [rad], N x 1; NaN and -1 where nothing returns.
      fields = struct('state', state, 'directions_camera', directions_camera);
      fields = GlRenderClient.with_options(fields, varargin, {'camera', 'noise'});
      [arrays, header_bytes] = self.ask('range', fields);
      reply = GlRenderReply(arrays{1}, header_bytes);
    end
  end

  methods (Access = private)
    function [arrays, header_bytes] = ask_frames(self, fields)
      self.Progress = [];
      if isfield(fields, 'progress')
        self.Progress = fields.progress;
        fields = rmfield(fields, 'progress');
      end
      if self.SharedMemory
        fields.shared = true;
      end
      [arrays, header_bytes] = self.ask('render', fields);
      if isempty(arrays)
        self.SharedMemory = false;  % that memory cannot be read from here
        [arrays, header_bytes] = self.ask('render', rmfield(fields, 'shared'));
      end
    end

    function [arrays, header_bytes] = ask(self, op, fields)
      if self.IsClosed
        error('glrender:closed', 'this client is closed');
      end
      request = self.packed(op, fields);
      for attempt = 0:self.Retries
        try
          [arrays, header_bytes] = self.once(request);
          return
        catch problem
          is_ours = any(strcmp(problem.identifier, {'glrender:timeout', 'glrender:connection'}));
          self.disconnect_after(problem.identifier);
          if ~is_ours || attempt == self.Retries
            rethrow(problem);
          end
        end
      end
    end

    function request = packed(self, op, fields)
      fields.v = uint8(1);
      fields.op = op;
      fields.id = uint64(self.NextId);
      fields.client = self.Name;
      self.NextId = self.NextId + 1;
      request = struct('id', double(fields.id), 'bytes', glr_frame(glr_pack(fields)));
    end

    function [arrays, header_bytes] = once(self, request)
      if isempty(self.Socket)
        self.connect();
      end
      try
        written = write(self.Socket, request.bytes);
      catch problem
        error('glrender:connection', 'the request was not sent: %s', problem.message);
      end
      if exist('OCTAVE_VERSION', 'builtin') && written ~= numel(request.bytes)
        error('glrender:connection', 'the connection to %s:%d is closed', self.Host, self.Port);
      end
      if ~isempty(self.Progress)
        self.watch(self.Progress);
      end
      while true
        [header_bytes, parts] = self.receive();
        header = self.first_of(header_bytes);
        if header.id == request.id || header.id == 0
          break
        end
        % Otherwise the late reply to a request given up before.
      end
      if ~header.ok
        problem = glr_unpack(header_bytes).error;
        error(['glrender:', problem.code], '%s', problem.message);
      end
      arrays = {struct()};
      if isfield(header, 'shared')
        parts = glr_shared(header.shared);
        if isempty(parts)
          arrays = {};
          return
        end
      end
      for k = 1:numel(header.arrays)
        entry = header.arrays{k};
        frame = 1;
        if isfield(entry, 'frame')
          frame = entry.frame + 1;
        end
        arrays{frame}.(entry.name) = glr_array(entry, parts{entry.part});
      end
    end

    function header = first_of(self, bytes)
      % A header up to `arrays`. Those of like requests differ in `id` and `shared` alone: read are only these then.
      at = 2 + 2 * (bytes(1) == 222);
      place = [];
      if numel(bytes) > at + 6 && isequal(bytes(at:at + 6), [uint8(166), uint8('shared')])
        [place, at] = glr_unpack(bytes, 'shared');
      end
      known = self.Known;
      if ~isempty(known)
        from = at + numel(known.before);
        to = from + numel(known.after) + 2;
        % Three bytes of an id, from 256 to 65535; others are read at length.
        if numel(bytes) >= to && bytes(from) == 205 && all(bytes(at:from - 1) == known.before) ...
            && all(bytes(from + 3:to) == known.after)
          header = known.header;
          header.id = 256 * double(bytes(from + 1)) + double(bytes(from + 2));
          if ~isempty(place)
            header.shared = place.shared;
          end
          return
        end
      end
      [header, last] = glr_unpack(bytes, 'arrays');
      from = at + 16;  % behind v, op, and the key of id
      if last > from + 3 && strcmp(header.op, 'render') && bytes(from) == 205
        self.Known = struct('before', bytes(at:from - 1), 'after', bytes(from + 3:last - 1), 'header', header);
        if ~isempty(place)
          self.Known.header = rmfield(header, 'shared');
        end
      end
    end

    function watch(self, progress)
      % Tell how far slow frames are until the reply begins to come, asking by another connection.
      began = tic();
      due = 0.5;
      other = [];
      while toc(began) < self.Timeout && GlRenderClient.n_waiting(self.Socket) == 0
        pause(0.02);
        if toc(began) < due
          continue
        end
        due = toc(began) + 0.5;
        try
          if isempty(other)
            other = GlRenderClient(self.Host, self.Port, 'Timeout', self.Timeout, 'Retries', 0);
          end
          told = other.status();
        catch
          return  % what is wrong, the reply will tell
        end
        if isfield(told, 'slow_frames') && ~isempty(told.slow_frames)
          progress(max(told.slow_frames));
        end
      end
    end

    function [header_bytes, parts] = receive(self)
      prefix = self.exactly(12);  % with the first part's size: every message has one
      n_parts = double(typecast(prefix(5:6), 'uint16'));
      if ~isequal(char(prefix(1:4)), 'GLR1') || n_parts < 1
        error('glrender:protocol', 'the server at %s:%d does not speak GLR1', self.Host, self.Port);
      end
      rest = 4 * (n_parts - 1);
      bytes = self.exactly(rest + double(typecast(prefix(9:12), 'uint32')));
      sizes = double(typecast(bytes(1:rest), 'uint32'));
      header_bytes = bytes(rest + 1:end);
      parts = cell(1, n_parts - 1);
      for k = 1:n_parts - 1
        parts{k} = self.exactly(sizes(k));
      end
    end

    function bytes = exactly(self, count)
      % One read each: chunks of 64 KiB cost three times as much. MATLAB's read gives doubles, hence uint8().
      if count == 0
        bytes = zeros(1, 0, 'uint8');
        return
      end
      try
        bytes = reshape(uint8(read(self.Socket, count, 'uint8')), 1, []);
      catch problem
        if ~isempty(regexpi([problem.identifier, ' ', problem.message], 'time-?out|timed out', 'once'))
          bytes = zeros(1, 0, 'uint8');  % MATLAB may raise what Octave tells by a short result
        else
          error('glrender:connection', 'the connection to %s:%d is lost: %s', self.Host, self.Port, ...
                problem.message);
        end
      end
      if numel(bytes) ~= count
        error('glrender:timeout', '%s:%d did not answer within %g s', self.Host, self.Port, self.Timeout);
      end
    end

    function connect(self)
      try
        if exist('OCTAVE_VERSION', 'builtin')
          self.Socket = tcpclient(self.Host, self.Port, 'Timeout', self.Timeout);
        else
          try
            self.Socket = tcpclient(self.Host, self.Port, 'Timeout', self.Timeout, 'EnableTransferDelay', false);
          catch
            self.Socket = tcpclient(self.Host, self.Port, 'Timeout', self.Timeout);  % before R2020b
          end
        end
      catch problem
        error('glrender:connection', ['no server at %s:%d (%s); start one with: glrender-server scene.toml ', ...
              '--tcp %s:%d'], self.Host, self.Port, problem.message, self.Host, self.Port);
      end
    end

    function disconnect(self)
      self.Socket = [];  % the last reference closes it, in MATLAB and in Octave
    end

    function disconnect_after(self, identifier)
      % After an answer in full the connection is sound; after anything else a reply may be half read.
      if any(strcmp(identifier, {'glrender:timeout', 'glrender:connection', 'glrender:protocol'})) ...
          || isempty(strfind(identifier, 'glrender:')) %#ok<STREMP>
        self.disconnect();
      end
    end
  end

  methods (Static, Access = private)
    function count = n_waiting(socket)
      try
        count = socket.NumBytesAvailable;
      catch
        count = socket.BytesAvailable;  % before R2020b
      end
    end

    function names = request_options()
      names = {'allow_slow', 'progress'};
    end

    function names = frame_options()
      names = {'camera', 'output', 'exposure_s', 'seed', 'max_error', 'samples', 'products', 'roi'};
    end

    function fields = with_list(fields)
      if isfield(fields, 'products') && ischar(fields.products)
        fields.products = {fields.products};
      end
    end

    function options = with_options(options, pairs, known)
      if mod(numel(pairs), 2)
        error('glrender:argument', 'options come in pairs: name, value');
      end
      for k = 1:2:numel(pairs)
        if ~ischar(pairs{k}) || ~any(strcmp(pairs{k}, known))
          error('glrender:argument', 'unknown option; known are %s', strjoin(known(:).', ', '));
        end
        options.(pairs{k}) = pairs{k + 1};
      end
    end

    function text = unique_text()
      % Without a call of rand, which would disturb the user's random numbers.
      text = '';
      while numel(text) < 16
        [~, name] = fileparts(tempname());
        text = [text, regexprep(name, '\W', '')]; %#ok<AGROW>
      end
      text = sprintf('%s-%d', text, round(1e6 * mod(now, 1) * 86400)); %#ok<TNOW1>
      text = text(1:min(end, 100));
    end
  end
end
