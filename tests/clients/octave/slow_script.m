% Frames of another backend through the class and the MEX function. Arguments: host, port, JSON state.
given = argv();
[host, port, state] = deal(given{end - 2}, str2double(given{end - 1}), jsondecode(fileread(given{end})));
client = GlRenderClient(host, port, 'Timeout', 100);
traced = @(plan) isempty(plan.windows);
told = containers.Map('shares', []);  % a handle: what a callback wrote lasts
options = {'camera', 'navcam', 'max_error', 1e-3};

fast = client.render(state, options{:}, 'progress', @(share) error('check:failed', 'nothing is slow here'));
check(~traced(fast.header.plan), 'the server''s own backend');
began = tic();
slow = client.render(state, options{:}, 'backend', 'raytrace', 'progress', @(share) note_share(told, share));
check(traced(slow.header.plan), 'the ray tracer was asked');
check(toc(began) > 0.7, 'shares are told after half a second: a slower frame is needed');
shares = told('shares');
check(~isempty(shares) && issorted(shares) && all(shares >= 0 & shares <= 1), 'progress: %s', mat2str(shares));
several = client.render_frames(state, {struct('camera', 'navcam', 'max_error', 1e-3)}, 'backend', 'raytrace');
check(isequal(several{1}.pixels, slow.pixels), 'the same frame');
expect_error('glrender:config', 'backend', @() client.render(state, options{:}, 'backend', 'vulkan'));
client.close();

handle = glrender_mex('open', host, port, 100);
options = struct('camera', 'navcam', 'max_error', 1e-3, 'backend', 'raytrace');
check(isequal(glrender_mex('render', handle, state, options).image, slow.pixels), 'mex');
options = struct('camera', 'navcam', 'max_error', 1e-3);
check(isequal(glrender_mex('render', handle, state, options).image, fast.pixels), 'mex, the server''s own');
options.backend = 'vulkan';
expect_error('glrender:config', 'backend', @() glrender_mex('render', handle, state, options));
glrender_mex('close', handle);
fprintf('GLRENDER CHECKED\n');
