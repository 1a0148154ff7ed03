% Slow frames through the class and the MEX function. Arguments: host, port, JSON state.
given = argv();
[host, port, state] = deal(given{end - 2}, str2double(given{end - 1}), jsondecode(fileread(given{end})));
client = GlRenderClient(host, port, 'Timeout', 100);
drawn_slowly = @(plan) any(strncmp(plan.warnings, 'raytrace leaves', 15));
told = containers.Map('shares', []);  % a handle: what a callback wrote lasts
options = {'camera', 'navcam', 'max_error', 1e-3};

fast = client.render(state, options{:}, 'progress', @(share) error('check:failed', 'nothing is slow here'));
check(fast.header.plan.predicted_error > 1e-3 && ~drawn_slowly(fast.header.plan), 'not allowed');
began = tic();
slow = client.render(state, options{:}, 'allow_slow', 'raytrace', 'progress', @(share) note_share(told, share));
check(drawn_slowly(slow.header.plan), 'the ray tracer was asked');
check(toc(began) > 0.7, 'shares are told after half a second: a slower frame is needed');
shares = told('shares');
check(~isempty(shares) && issorted(shares) && all(shares >= 0 & shares <= 1), 'progress: %s', mat2str(shares));
several = client.render_frames(state, {struct('camera', 'navcam', 'max_error', 1e-3)}, 'allow_slow', 'raytrace');
check(isequal(several{1}.pixels, slow.pixels), 'the same frame');
expect_error('glrender:config', 'allow_slow', @() client.render(state, options{:}, 'allow_slow', 'vulkan'));
client.close();

handle = glrender_mex('open', host, port, 100);
options = struct('camera', 'navcam', 'max_error', 1e-3, 'allow_slow', 'raytrace');
check(isequal(glrender_mex('render', handle, state, options).image, slow.pixels), 'mex');
options.allow_slow = false;
check(isequal(glrender_mex('render', handle, state, options).image, fast.pixels), 'mex, not allowed');
options = struct('camera', 'navcam', 'max_error', 0.5, 'allow_slow', true);
check(~isempty(glrender_mex('render', handle, state, options).image), 'mex, true');
options.allow_slow = 'vulkan';
expect_error('glrender:config', 'allow_slow', @() glrender_mex('render', handle, state, options));
glrender_mex('close', handle);
fprintf('GLRENDER CHECKED\n');
