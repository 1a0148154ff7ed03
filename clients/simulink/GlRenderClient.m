classdef GlRenderClient < handle
%GLRENDERCLIENT  Asks a glrender server for frames, over framed TCP; needs no toolbox.
%   client = GlRenderClient()                           127.0.0.1, port 5556 (glrender-server scene.toml --tcp ...)
%   client = GlRenderClient(host, port, 'Timeout', 10, 'Retries', 1, 'SharedMemory', true)
%   reply = client.render(state, 'camera', 'navcam', 'output', 'dn', 'exposure_s', 0.1, 'seed', 7)
%   reply.pixels                                        height x width, row 1 on top
%   client.close()
%
%   `state` is the struct of docs/protocol.md: t_s, r_sun_inertial_m, spacecraft.r_inertial_m,
%   spacecraft.q_from_inertial ([w x y z]), bodies.NAME.r_inertial_m, bodies.NAME.q_from_inertial. Without t_s it is 0;
%   without q_from_inertial the axes are the inertial ones. Aerospace Toolbox's q = dcm2quat(C), angle2quat(...) and
%   Aerospace Blockset's quaternions turn frames: give their conjugates, [q(1), -q(2:4)].
%   A body whose name is no MATLAB name: make `bodies` a containers.Map.
%
%   Errors: glrender:CODE with the codes of docs/protocol.md (glrender:config, glrender:scene, glrender:busy, ...),
%   glrender:timeout, glrender:connection, glrender:protocol, glrender:closed, glrender:argument.

  properties (SetAccess = private)
    Host
    Port
    Timeout   % [s], of each try; a busy server is asked again meanwhile, in pauses that grow
    Retries   % further tries after a timeout or a lost connection, each over a new connection
    Name      % of this client; the server answers a repeated request from its last reply
    SharedMemory  % whether frames are read in the memory of a server on this machine; by default on Linux
  end

  properties (Access = private)
    Where        % 'host:port'
    Socket = []
    NextId = 256
    IsClosed = false
    Packed = []  % of the last request, for the next like it: see glr_request
    Read = []    % of the last reply, likewise: see glr_header
    Scene = ''   % digest of the scene that load_scene has loaded: no frame of another comes in its place
    RetryAfter = 0.05  % [s], as the last `busy` reply said
    NNoisy = 0   % frames with noise that were asked for without a seed: the number of each is its seed
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
      self.Where = sprintf('%s:%d', host, port);
      is_here = strcmp(host, '127.0.0.1') && exist('/dev/shm', 'dir') == 7;
      options = struct('Timeout', 10, 'Retries', 1, 'SharedMemory', is_here);
      given = GlRenderClient.checked(varargin, fieldnames(options));
      for k = 1:2:numel(given)
        options.(given{k}) = given{k + 1};
      end
      if ~(options.Timeout > 0) || ~(options.Retries >= 0)
        error('glrender:argument', 'Timeout must be > 0 [s] and Retries >= 0');
      end
      self.Timeout = options.Timeout;
      self.Retries = options.Retries;
      self.SharedMemory = logical(options.SharedMemory);
      self.Name = sprintf('matlab-%s', GlRenderClient.unique_text());
      if exist('OCTAVE_VERSION', 'builtin')
        glr_octave();
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
          self.once(self.packed('close', {}, []), []);
        catch
          % A server that is gone keeps nothing of ours.
        end
      end
      self.disconnect();
      self.IsClosed = true;
    end

    function header = hello(self)
      %HELLO  What the server is: protocol versions, cameras, bodies, products, limits, OpenGL.
      [~, bytes] = self.ask('hello', {}, []);
      header = glr_unpack(bytes);
    end

    function header = status(self)
      %STATUS  How the server does: uptime_s, requests, errors by code, last_timings_ms.
      [~, bytes] = self.ask('status', {}, []);
      header = glr_unpack(bytes);
    end

    function header = load_scene(self, scene)
      %LOAD_SCENE  Replace the server's scene, for every client: the struct of a scene file (docs/scene.md).
      %   From then on, where the server shows another scene, this client's frames and ranges end with glrender:scene.
      [~, bytes] = self.ask('load_scene', {'scene', scene}, []);
      header = glr_unpack(bytes);
      self.Scene = '';  % an older server names none, and takes no field `scene`
      if isfield(header, 'scene')
        self.Scene = header.scene;
      end
    end

    function reply = render(self, state, varargin)
      %RENDER  One frame.
      %   reply = client.render(state, NAME, VALUE, ...) with the names of docs/protocol.md: camera, output
      %   ('irradiance', 'dn' or 'compressed'), exposure_s, seed, max_error, samples, products (cell of names), roi
      %   ([x0 y0 x1 y1], pixels from 0, one past the last: whole(y0 + 1:y1, x0 + 1:x1)), faults (cell of structs),
      %   backend ('raytrace' or 'cycles': who draws, in seconds or minutes, instead of the server's own backend; give
      %   the client a Timeout as long).
      %   deadline_s: nothing more is begun after this time [s]; reply.header.is_late says whether the frame took longer.
      %   Without a seed, frames with noise are counted from 0; reply.header.seed has it.
      %   max_error is a number, or a struct of any of rms, flux, centroid_px, limb_px, range.
      %   'compare', frame: the camera's digital numbers (uint8, uint16, single or double, of 1 MB at most, or of roi) are
      %   compared with those that the state and exposure_s predict, and no image comes: reply.header.comparison has
      %   names, units, matrix, vector, chi2, gain, ... (docs/protocol.md): vertcat(c.matrix{:}) \ c.vector.' is the step
      %   that explains the frame. With it go derivatives, unknown (cells of names), blur_px and robust.
      %   'progress', @(share) fprintf('%.0f %%\n', 100 * share) is called about twice a second while a server with
      %   worker processes draws slow frames.
      %   The result is a GlRenderReply: reply.pixels, reply.arrays.PRODUCT, reply.header.
      pairs = GlRenderClient.checked(varargin, [GlRenderClient.frame_options(), GlRenderClient.request_options()]);
      for k = 2 * find(ismember(pairs(1:2:end), {'products', 'derivatives', 'unknown'}))
        pairs{k} = GlRenderClient.list(pairs{k});
      end
      pairs = glr_compare_pairs(pairs);
      [arrays, header_bytes] = self.ask_frames(self.seeded(pairs), state);
      reply = GlRenderReply(arrays{1}, header_bytes);
    end

    function replies = render_frames(self, state, frames, varargin)
      %RENDER_FRAMES  Several frames of one state in one request; a cell of GlRenderReply, in their order.
      %   frames: cell of structs with the options of `render`: {struct('camera', 'navcam'), struct('camera', 'wac')}.
      %   15 images and products in all; one frame that is refused refuses all. Then NAME, VALUE of backend, progress.
      if ~iscell(frames) || ~all(cellfun(@(frame) isstruct(frame) && isscalar(frame), frames))
        error('glrender:argument', 'frames must be a cell of structs');
      end
      for k = 1:numel(frames)
        wrong = setdiff(fieldnames(frames{k}), GlRenderClient.frame_options());
        if ~isempty(wrong)
          error('glrender:argument', 'frames{%d}: unknown option %s', k, wrong{1});
        end
        for name = intersect(fieldnames(frames{k}), {'products', 'derivatives', 'unknown'}).'
          frames{k}.(name{1}) = GlRenderClient.list(frames{k}.(name{1}));
        end
        if isfield(frames{k}, 'compare')
          error('glrender:argument', 'frames{%d}: compare belongs to render', k);
        end
        pairs = self.seeded(reshape([fieldnames(frames{k}), struct2cell(frames{k})].', 1, []));
        if numel(pairs) > 2 * numel(fieldnames(frames{k}))
          frames{k}.seed = pairs{end};
        end
      end
      pairs = GlRenderClient.checked(varargin, GlRenderClient.request_options());
      [arrays, header_bytes] = self.ask_frames([pairs, {'frames', reshape(frames, 1, [])}], state);
      replies = cell(1, numel(frames));
      for k = 1:numel(frames)
        replies{k} = GlRenderReply(arrays{k}, header_bytes, k);
      end
    end

    function reply = range(self, state, directions_camera, varargin)
      %RANGE  Laser ranges along directions (N x 3 unit vectors in the camera's frame), exact against the facets.
      %   reply = client.range(state, directions, 'camera', 'navcam', 'noise', struct('sigma_m', 0.1, 'seed', 1))
      %   reply.arrays: range [m], body_id, facet_id, beam_incidence [rad], N x 1; NaN and -1 where nothing returns.
      pairs = GlRenderClient.checked(varargin, {'camera', 'noise'});
      [arrays, header_bytes] = self.ask('range', [self.meant(), pairs, {'directions_camera', directions_camera}], state);
      reply = GlRenderReply(arrays{1}, header_bytes);
    end
  end

  methods (Access = private)
    function pairs = meant(self)
      pairs = {};
      if ~isempty(self.Scene)
        pairs = {'scene', self.Scene};
      end
    end

    function pairs = seeded(self, pairs)
      % A frame with noise that was given no seed gets the number of such frames before it: noise moves.
      names = pairs(1:2:end);
      outputs = pairs(2 * find(strcmp(names, 'output')));
      if any(ismember(outputs(cellfun(@ischar, outputs)), {'dn', 'compressed'})) && ~any(strcmp(names, 'seed'))
        pairs = [pairs, {'seed', uint64(self.NNoisy)}];
        self.NNoisy = self.NNoisy + 1;
      end
    end

    function [arrays, header_bytes] = ask_frames(self, pairs, state)
      progress = [];
      at = find(strcmp(pairs(1:2:end), 'progress'));
      if ~isempty(at)
        progress = pairs{2 * at(end)};
        pairs([2 * at - 1, 2 * at]) = [];
      end
      pairs = [{'order', 'F'}, self.meant(), pairs];
      if self.SharedMemory
        [arrays, header_bytes] = self.ask('render', [{'shared', true}, pairs], state, progress);
        if ~isempty(arrays)
          return
        end
        self.SharedMemory = false;  % that memory cannot be read from here
      end
      [arrays, header_bytes] = self.ask('render', pairs, state, progress);
    end

    function [arrays, header_bytes] = ask(self, op, pairs, state, progress)
      if self.IsClosed
        error('glrender:closed', 'this client is closed');
      end
      if nargin < 5
        progress = [];
      end
      request = self.packed(op, pairs, state);
      attempt = 0;
      busy = 0;
      began = tic();
      while true
        try
          [arrays, header_bytes] = self.once(request, progress);
          return
        catch problem
          self.disconnect_after(problem.identifier);
          if strcmp(problem.identifier, 'glrender:busy')
            % Longer each time, and by chance: that of the clock, as rand is the caller's.
            chance = 0.5 + mod(now() * 86400e3, 1);
            seconds = min(self.RetryAfter * 1.5 ^ min(busy, 20), 5) * chance;
            busy = busy + 1;
            if toc(began) + seconds > self.Timeout
              rethrow(problem);
            end
            pause(seconds);
            continue
          end
          is_ours = any(strcmp(problem.identifier, {'glrender:timeout', 'glrender:connection'}));
          if ~is_ours || attempt == self.Retries
            rethrow(problem);
          end
          attempt = attempt + 1;
        end
      end
    end

    function request = packed(self, op, pairs, state)
      request.id = self.NextId;
      self.NextId = 256 + mod(request.id - 255, 65280);  % three bytes of MessagePack: see glr_header
      pairs = [{'op', op, 'client', self.Name}, pairs];
      [request.bytes, self.Packed] = glr_request(self.Packed, request.id, pairs, state);
    end

    function [arrays, header_bytes] = once(self, request, progress)
      if isempty(self.Socket)
        self.connect();
      end
      try
        written = write(self.Socket, request.bytes);
      catch problem
        error('glrender:connection', 'the request was not sent: %s', problem.message);
      end
      if exist('OCTAVE_VERSION', 'builtin') && written ~= numel(request.bytes)
        error('glrender:connection', 'the connection to %s is closed', self.Where);
      end
      if ~isempty(progress)
        glr_watch(self.Socket, self.Host, self.Port, self.Timeout, progress);
      end
      while true
        [header_bytes, parts] = glr_receive(self.Socket, self.Timeout, self.Where);
        [header, self.Read] = glr_header(header_bytes, self.Read);
        if header.id == request.id || header.id == 0
          break
        end
        % Otherwise the late reply to a request given up before.
      end
      if ~header.ok
        problem = glr_unpack(header_bytes).error;
        if isfield(problem, 'retry_after_s')
          self.RetryAfter = problem.retry_after_s;
        end
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
        error('glrender:connection', 'no server at %s (%s); start one with: glrender-server scene.toml --tcp %s', ...
              self.Where, problem.message, self.Where);
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
    function names = request_options()
      names = {'backend', 'progress'};
    end

    function names = frame_options()
      names = {'camera', 'output', 'exposure_s', 'seed', 'max_error', 'samples', 'products', 'roi', ...
               'faults', 'deadline_s', 'compare', 'derivatives', 'unknown', 'blur_px', 'robust'};
    end

    function names = list(names)
      if ischar(names)
        names = {names};
      end
    end

    function pairs = checked(pairs, known)
      if mod(numel(pairs), 2)
        error('glrender:argument', 'options come in pairs: name, value');
      end
      for k = 1:2:numel(pairs)
        if ~ischar(pairs{k}) || ~any(strcmp(pairs{k}, known))
          error('glrender:argument', 'unknown option; known are %s', strjoin(known(:).', ', '));
        end
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
