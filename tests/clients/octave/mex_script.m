% glrender_mex against a live server. Arguments: host, port, port of a mute server, folder for pixels, JSON state.
given = argv();
[host, port, folder] = deal(given{end - 4}, str2double(given{end - 3}), given{end - 1});
mute_port = str2double(given{end - 2});
state = jsondecode(fileread(given{end}));
handle = glrender_mex('open', host, port, 30);

% Every class of the protocol; Python compares the files.
products = {'range', 'body_id', 'facet_id', 'incidence', 'emission', 'phase', 'r_body', 'sunlit'};
reply = glrender_mex('render', handle, state, struct('camera', 'navcam', 'products', {products}));
check(isequal(fieldnames(reply).', [{'image'}, products, {'header_bytes'}]), 'names of the arrays');
check(isa(reply.image, 'single') && isequal(size(reply.image), [64 96]), 'image');
check(isa(reply.body_id, 'int32') && isa(reply.range, 'double') && isequal(size(reply.r_body), [64 96 3]), 'classes');
for name = fieldnames(reply).'
  keep(folder, name{1}, reply.(name{1}));
end
options = struct('camera', 'navcam', 'output', 'dn', 'exposure_s', 0.02, 'seed', 7);
dn = glrender_mex('render', handle, state, options).image;
check(isa(dn, 'uint16'), 'uint16');
keep(folder, 'dn', dn);
without = rmfield(options, 'seed');
for seed = 0:1
  options.seed = seed;
  check(isequal(glrender_mex('render', handle, state, without).image, ...
                glrender_mex('render', handle, state, options).image), 'frames without a seed are counted');
end
options.seed = intmax('uint64');
keep(folder, 'dn_largest_seed', glrender_mex('render', handle, state, options).image);
options.exposure_s = 'auto';
keep(folder, 'dn_auto', glrender_mex('render', handle, state, options).image);
keep(folder, 'samples', glrender_mex('render', handle, state, struct('camera', 'navcam', 'samples', 11)).image);
fine = struct('camera', 'navcam', 'max_error', 0.001);
keep(folder, 'fine', glrender_mex('render', handle, state, fine).image);
units = struct('camera', 'navcam', 'max_error', struct('centroid_px', 0.004, 'flux', 5e-4));
keep(folder, 'by_unit', glrender_mex('render', handle, state, units).image);

% The frames of the class, byte for byte; a region; several cameras in one request.
client = GlRenderClient(host, port, 'Timeout', 30);
check(isequal(client.render(state, 'camera', 'navcam', 'output', 'dn', 'exposure_s', 0.02, 'seed', 7).pixels, dn), 'class');
frames = {struct('camera', 'byte', 'output', 'dn', 'seed', 3), ...
          struct('camera', 'navcam', 'products', 'r_body', 'roi', [30 20 71 45]), struct('camera', 'bare')};
replies = glrender_mex('render', handle, state, frames);
theirs = client.render_frames(state, frames);
check(numel(replies) == 3 && isa(replies{1}.image, 'uint8'), 'three frames');
for k = 1:3
  for name = fieldnames(rmfield(replies{k}, 'header_bytes')).'
    check(isequaln(replies{k}.(name{1}), theirs{k}.arrays.(name{1})), 'frame %d, %s', k, name{1});
  end
end
keep(folder, 'region', replies{2}.image);
one = glrender_mex('render', handle, state, frames(3));
check(iscell(one) && isequal(one{1}.image, replies{3}.image), 'a list of one');
check(isequal(client.render(state, 'camera', 'navcam', 'max_error', units.max_error).pixels, ...
              glrender_mex('render', handle, state, units).image), 'tolerances by unit');
client.close();

% What is wrong, by identifier; the connection stays sound.
render = @(varargin) glrender_mex('render', handle, state, varargin{:});
expect_error('glrender:scene', '(^|[^.\]])camera: unknown camera', @() render(struct('camera', 'wac')));
late = struct('camera', 'navcam', 'output', 'dn', 'exposure_s', 100, 'seed', 5, 'deadline_s', 1e-6);
facts = glr_unpack(render(late).header_bytes);
check(facts.seed == 5 && facts.is_late && isfield(facts, 'plan') && isfield(facts, 'stages'), 'facts of a reply');
check(any(cellfun(@(warning) strcmp(warning.code, 'saturated'), facts.warnings)), 'warnings of a reply');
expect_error('glrender:config', 'max_error.flux: must be at least', ...
             @() render(struct('camera', 'bare', 'max_error', struct('flux', 1e-9, 'range', 0.1))));
expect_error('glrender:config', 'roi\[2\]', @() render(struct('camera', 'bare', 'roi', [0 0 33 1])));
bad = state;
bad.spacecraft.q_from_inertial = [1 1 0 0];
expect_error('glrender:config', 'norm must be 1', @() glrender_mex('render', handle, bad, struct('camera', 'bare')));
wrong = {struct('kamera', 'bare'), 'unknown option kamera'; struct('camera', 7), 'camera must be text'; ...
         struct('output', 'png'), 'irradiance'; struct('seed', 1), 'belong to output'; ...
         struct('output', 'dn', 'seed', -1), 'seed must be an integer'; struct('output', 'dn', 'seed', 0.5), 'seed must'; ...
         struct('output', 'dn', 'exposure_s', 0), 'exposure_s must be > 0'; struct('samples', 17), 'samples must be'; ...
         struct('output', 'dn', 'exposure_s', 'long'), 'exposure_s must be 1 real'; ...
         struct('max_error', NaN), 'max_error must be'; struct('roi', [0 0 1]), 'roi must be 4'; ...
         struct('max_error', struct('flux', 0)), 'max_error.flux must be'; ...
         struct('max_error', struct('centroid', 1)), 'unknown unit max_error.centroid'; ...
         struct('roi', [0 0 0.5 1]), 'four integers'; struct('roi', [5 0 5 1]), 'x0 < x1'; ...
         struct('products', 7), 'products must be text'; 'bare', 'options must be a struct'; {}, '1 to 15 frames'; ...
         repmat({struct()}, 1, 16), '1 to 15 frames'; {1}, 'options must be a struct'};
for k = 1:size(wrong, 1)
  expect_error('glrender:argument', wrong{k, 2}, @() render(wrong{k, 1}));
end
for name = {'r_sun_inertial_m', 'spacecraft', 'bodies'}
  bad = rmfield(state, name{1});
  expect_error('glrender:argument', ['state.', name{1}], @() glrender_mex('render', handle, bad, struct()));
end
bad = state;
bad.bodies.body.q_from_inertial = [1 0 0];
expect_error('glrender:argument', 'state.bodies.body.q_from_inertial must be 4', ...
             @() glrender_mex('render', handle, bad, struct()));
whole = state;
whole.t_s = 0;
whole.spacecraft.q_from_inertial = [1 0 0 0];
short = rmfield(state, 't_s');
short.spacecraft = rmfield(short.spacecraft, 'q_from_inertial');
check(isequal(glrender_mex('render', handle, short, struct('camera', 'bare')).image, ...
              glrender_mex('render', handle, whole, struct('camera', 'bare')).image), 'defaults');
expect_error('glrender:argument', '.', @() glrender_mex());
expect_error('glrender:argument', '.', @() glrender_mex('draw', handle));
expect_error('glrender:argument', 'port must be', @() glrender_mex('open', host, 0, 1));
check(isequal(render(options).image, glrender_mex('render', handle, state, options).image), 'serves on');

% A mute server, none at all, a closed handle, many clients.
quick = glrender_mex('open', host, mute_port, 0.3);
expect_error('glrender:timeout', 'did not answer within 0.3 s: the connection stands, so the server is busy', ...
             @() glrender_mex('render', quick, state, struct('camera', 'bare')));
none = glrender_mex('open', host, 1, 1);
expect_error('glrender:connection', 'start a server', @() glrender_mex('render', none, state, struct('camera', 'bare')));
glrender_mex('close', handle);
expect_error('glrender:closed', '.', @() render(struct('camera', 'bare')));
expect_error('glrender:closed', '.', @() glrender_mex('close', handle));
others = arrayfun(@(k) glrender_mex('open', host, port, 30), 1:62);
check(numel(unique([others, quick, none])) == 64, 'handles differ');
expect_error('glrender:argument', '64 clients are open', @() glrender_mex('open', host, port, 30));
arrayfun(@(other) glrender_mex('close', other), others(1:61));
check(isequal(glrender_mex('render', others(62), state, struct('camera', 'bare')).image, replies{3}.image), 'the last');
fprintf('GLRENDER CHECKED\n');
