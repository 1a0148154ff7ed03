% GlRenderClient against a live server. Arguments: host, port, port of a mute server, folder for pixels, JSON state.
given = argv();
[host, port, folder] = deal(given{end - 4}, str2double(given{end - 3}), given{end - 1});
mute_port = str2double(given{end - 2});
state = jsondecode(fileread(given{end}));

client = GlRenderClient(host, port, 'Timeout', 30);
hello = client.hello();
check(isequal(hello.protocol, 1) && strcmp(hello.cameras{1}.name, 'navcam'), 'hello');
check(hello.bodies{1}.n_facets == 5120, 'n_facets');

% Every dtype of the protocol, pixel by pixel: the Python client compares the files.
products = {'range', 'body_id', 'facet_id', 'incidence', 'r_body', 'sunlit'};
reply = client.render(state, 'camera', 'navcam', 'products', products);
check(isa(reply.pixels, 'single') && isequal(size(reply.pixels), [64 96]), 'image');
check(isequal(size(reply.arrays.r_body), [64 96 3]) && isa(reply.arrays.body_id, 'int32') && isa(reply.arrays.range, 'double'), 'classes');
check(strcmp(reply.header.unit, 'W/m2') && reply.header.plan.predicted_error > 0, 'header');
keep(folder, 'image', reply.pixels);
for k = 1:numel(products)
  keep(folder, products{k}, reply.arrays.(products{k}));
end
reply = client.render(state, 'camera', 'navcam', 'output', 'dn', 'exposure_s', 0.02, 'seed', uint64(7));
check(isa(reply.pixels, 'uint16') && reply.header.seed == 7, 'dn');
has = @(name) isfield(reply.header, name);
check(has('warnings') && has('notes') && has('stages') && isfield(reply.header.plan.predicted, 'centroid_px'), 'facts');
keep(folder, 'dn', reply.pixels);
for k = 0:1
  reply = client.render(state, 'camera', 'navcam', 'output', 'dn');
  check(reply.header.seed == k, 'noise moves: frames without a seed are counted');
end
check(client.render(state, 'camera', 'bare', 'deadline_s', 1e-6).header.is_late, 'a deadline');
reply = client.render_frames(state, {struct('camera', 'byte', 'output', 'dn'), struct('camera', 'bare')}){1};
check(reply.header.seed == 2, 'counted in several frames too');
reply = client.render(state, 'camera', 'byte', 'output', 'dn', 'seed', 3, 'products', 'range');
check(isa(reply.pixels, 'uint8') && isfield(reply.arrays, 'range'), 'uint8');
keep(folder, 'byte', reply.pixels);
reply = client.render(state, 'camera', 'byte', 'output', 'dn', 'faults', {struct('kind', 'lost_lines', 'n_lines', 3)});
lines = double(reply.header.faults{1}.lines);
check(numel(lines) == 3 && ~any(any(reply.pixels(lines + 1, :))), 'faults');

pixels = client.render(state, 'camera', 'byte', 'output', 'dn', 'seed', 3, 'exposure_s', 2e-7).pixels;
c = client.render(state, 'camera', 'byte', 'exposure_s', 2e-7, 'compare', pixels, 'unknown', 'gain').header.comparison;
step = vertcat(c.matrix{:}) \ c.vector.';
check(numel(c.names) == 7 && strcmp(c.names{7}, 'gain') && abs(c.gain - 1) < 0.1 && norm(step(1:2)) < 20, 'compare');
found = '';
try
  client.render(state, 'camera', 'byte', 'compare', int32(pixels));
catch problem
  found = problem.identifier;
end
check(strcmp(found, 'glrender:argument'), 'a class that is no frame');

% The same frames over the socket, and out of shared memory that is not there.
check(client.SharedMemory && ~isfield(reply.header, 'shared'), 'a small frame comes in the message');
sent = GlRenderClient(host, port, 'Timeout', 30, 'SharedMemory', false);
for roi = {[3 2 4 3], [30 10 71 63], [0 0 96 64]}
  options = {'camera', 'navcam', 'products', products, 'roi', roi{1}};
  here = client.render(state, options{:});
  there = sent.render(state, options{:});
  is_large = numel(here.pixels) > 1000;
  check(isfield(here.header, 'shared') == is_large && ~isfield(there.header, 'shared'), 'where the pixels are');
  check(isequaln(here.arrays, there.arrays), 'pixels');
end
place = here.header.shared;
check(numel(glr_shared(place)) == 1 + numel(products), 'still there');
check(isempty(glr_shared(setfield(place, 'number', place.number + 1))), 'another frame');
check(isempty(glr_shared(setfield(place, 'name', 'not_there'))), 'no such memory');
check(isempty(glr_shared(setfield(place, 'name', '../shm/x'))), 'a path');

% Replies that begin as the last one did, and others, in memory and in the message, with an error in between.
large = sent.render(state, 'camera', 'navcam', 'products', 'range').arrays;
small = sent.render(state, 'camera', 'byte', 'output', 'dn', 'seed', 3).pixels;
for k = [1 1 2 1 2 2 2 1 1]
  if k == 1
    check(isequaln(client.render(state, 'camera', 'navcam', 'products', 'range').arrays, large), 'large after %d', k);
  else
    check(isequal(client.render(state, 'camera', 'byte', 'output', 'dn', 'seed', 3).pixels, small), 'small');
    expect_error('glrender:scene', 'unknown camera', @() client.render(state, 'camera', 'wac'));
  end
end
sent.close();

% A region of interest, and several cameras in one request.
region = client.render(state, 'camera', 'navcam', 'output', 'dn', 'exposure_s', 0.02, 'seed', 7, 'roi', [30 20 71 45]);
check(isequal(size(region.pixels), [25 41]) && isequal(region.header.roi, [30 20 71 45]), 'roi');
keep(folder, 'region', region.pixels);
frames = {struct('camera', 'byte', 'output', 'dn', 'seed', 3), ...
          struct('camera', 'navcam', 'products', 'r_body', 'roi', [30 20 71 45]), struct('camera', 'bare')};
replies = client.render_frames(state, frames);
check(numel(replies) == 3 && strcmp(replies{2}.header.camera, 'navcam') && ~isfield(replies{2}.header, 'frames'), 'frames');
check(replies{3}.header.t_s == state.t_s && replies{1}.header.seed == 3 && isa(replies{1}.pixels, 'uint8'), 'headers');
keep(folder, 'frames_byte', replies{1}.pixels);
keep(folder, 'frames_r_body', replies{2}.arrays.r_body);
keep(folder, 'frames_bare', replies{3}.pixels);
expect_error('glrender:scene', 'frames\[1\].camera', @() client.render_frames(state, {struct('camera', 'bare'), struct('camera', 'wac')}));
expect_error('glrender:config', 'roi\[2\]', @() client.render(state, 'camera', 'bare', 'roi', [0 0 33 1]));
expect_error('glrender:argument', 'frames\{1\}: unknown option kamera', ...
             @() client.render_frames(state, {struct('kamera', 'wac')}));
expect_error('glrender:argument', 'cell of structs', @() client.render_frames(state, 'navcam'));

% Laser ranges, one ray and several.
directions = [0 0 1; 0.01 0 sqrt(1 - 1e-4); 1 0 0];
reply = client.range(state, directions, 'camera', 'navcam');
check(isequal(size(reply.arrays.range), [3 1]) && isnan(reply.arrays.range(3)), 'ranges');
check(isequal(reply.arrays.body_id, int32([0; 0; -1])) && strcmp(reply.header.camera, 'navcam'), 'bodies');
keep(folder, 'ranges', reply.arrays.range);
one = client.range(state, [0 0 1], 'camera', 'navcam', 'noise', struct('sigma_m', 0.5, 'seed', 3));
check(abs(one.arrays.range - reply.arrays.range(1)) < 5 && one.arrays.range ~= reply.arrays.range(1), 'noise');
expect_error('glrender:config', 'directions_camera\[0\]: norm', @() client.range(state, [0 0 2], 'camera', 'navcam'));

% Errors by identifier, and the connection stays sound.
bad = state;
bad.spacecraft.q_from_inertial = [1 1 0 0];
expect_error('glrender:config', 'spacecraft.q_from_inertial: norm must be 1', @() client.render(bad, 'camera', 'navcam'));
expect_error('glrender:scene', 'unknown camera', @() client.render(state, 'camera', 'wac'));
bad = state;
bad.t_s = NaN;
expect_error('glrender:config', 'state.t_s', @() client.render(bad, 'camera', 'navcam'));
expect_error('glrender:argument', 'unknown option', @() client.render(state, 'kamera', 'navcam'));
expect_error('glrender:argument', 'pairs', @() client.render(state, 'camera'));
expect_error('glrender:argument', 'Timeout', @() GlRenderClient(host, port, 'Timeout', -1));
check(isfield(client.status().errors, 'config'), 'status');

% A lost connection is made anew; too short a time is told; two clients keep their own.
other = GlRenderClient('localhost', port, 'Timeout', 30);
check(~strcmp(other.Name, client.Name), 'names must differ');
for k = 1:5
  state.t_s = k;
  check(client.render(state, 'camera', 'bare').header.t_s == k, 'own reply');
  state.t_s = -k;
  check(other.render(state, 'camera', 'bare').header.t_s == -k, 'own reply');
end
other.close();
expect_error('glrender:closed', 'closed', @() other.hello());
quick = GlRenderClient(host, mute_port, 'Timeout', 0.3, 'Retries', 2);
began = tic();
expect_error('glrender:timeout', 'did not answer within 0.3 s: the connection stands, so the server is busy', @() quick.hello());
check(toc(began) > 0.85 && toc(began) < 5, 'three tries');
expect_error('glrender:connection', 'start one with: glrender-server', @() GlRenderClient(host, 1));
bodies = containers.Map();
bodies('body') = state.bodies.body;
state.bodies = bodies;
check(client.render(state, 'camera', 'bare').header.ok, 'bodies as a Map');
client.close();
client.close();

% Requests packed like the one before, whatever is changed between them: the server must see what was meant.
client = GlRenderClient(host, port, 'Timeout', 30);
state.bodies = struct('body', bodies('body'));
fresh = @(varargin) GlRenderClient(host, port, 'Timeout', 30).render(varargin{:});
turned = orderfields(state, fliplr(1:4));
turned.spacecraft.q_from_inertial = turned.spacecraft.q_from_inertial.';
moving = state;
moving.spacecraft.v_inertial_m_s = [0 0 1];
for given = {state, turned, moving, state}
  for options = {{'camera', 'bare'}, {'camera', 'navcam', 'output', 'dn', 'seed', 3}, {'camera', 'navcam', 'output', 'dn', 'seed', 4}}
    given{1}.t_s = given{1}.t_s + 0.5;
    given{1}.spacecraft.r_inertial_m(1) = given{1}.spacecraft.r_inertial_m(1) + 10;
    reply = client.render(given{1}, options{1}{:});
    check(reply.header.t_s == given{1}.t_s, 'its own state');
    check(isequal(reply.pixels, fresh(given{1}, options{1}{:}).pixels), 'pixels of a client that packs it first');
  end
end
bad = state;
bad.spacecraft = rmfield(bad.spacecraft, 'r_inertial_m');
expect_error('glrender:config', 'spacecraft.r_inertial_m', @() client.render(bad, 'camera', 'bare'));
whole = state;
whole.t_s = 0;
whole.spacecraft.q_from_inertial = [1 0 0 0];
short = rmfield(state, 't_s');
short.spacecraft = rmfield(short.spacecraft, 'q_from_inertial');
reply = client.render(short, 'camera', 'bare');
check(reply.header.t_s == 0 && isequal(reply.pixels, client.render(whole, 'camera', 'bare').pixels), 'defaults');
bad = state;
bad.gamma = 1;
expect_error('glrender:config', 'state.gamma', @() client.render(bad, 'camera', 'bare'));
bad = state;
bad.spacecraft.r_inertial_m = [0 0 -1000 0];
bad.spacecraft.q_from_inertial = [1 0 0];
expect_error('glrender:config', 'spacecraft', @() client.render(bad, 'camera', 'bare'));

% As in MATLAB, or in an Octave whose tcpclient has another inside: by `read` alone.
options = {'camera', 'navcam', 'products', {'range'}};
direct = client.render(state, options{:});
inside = autoload();
inside = inside(strcmp({inside.function}, '__tcpclient_read__'));
check(isscalar(inside), 'what tcpclient reads by');
autoload(inside.function, inside.file, 'remove');
clear glr_receive
expect_error('glrender:connection', '.', @() GlRenderClient(host, port, 'Retries', 0).hello());
autoload(inside.function, inside.file);
for shared = [true false]
  plain = GlRenderClient(host, port, 'Timeout', 30, 'SharedMemory', shared);
  check(isequaln(plain.render(state, options{:}).arrays, direct.arrays), 'by read');
end
quick = GlRenderClient(host, mute_port, 'Timeout', 0.3, 'Retries', 0);
expect_error('glrender:timeout', 'did not answer within 0.3 s: the connection stands, so the server is busy', @() quick.hello());
fprintf('GLRENDER CHECKED\n');
