% Milliseconds of each frame in Octave. Arguments: host, port, camera, output, count, JSON state, 'class', 'class socket'
% (without shared memory) or 'mex'.
given = argv();
[host, port, camera, output] = deal(given{end - 6}, str2double(given{end - 5}), given{end - 4}, given{end - 3});
[count, state] = deal(str2double(given{end - 2}), jsondecode(fileread(given{end - 1})));
if strcmp(given{end}, 'mex')
  handle = glrender_mex('open', host, port, 60);
  options = struct('camera', camera, 'output', output);
  ask = @(state) glrender_mex('render', handle, state, options);
else
  client = GlRenderClient(host, port, 'Timeout', 60, 'SharedMemory', strcmp(given{end}, 'class'));
  ask = @(state) client.render(state, 'camera', camera, 'output', output);
end
for k = 1:count
  state.t_s = k;
  began = tic();
  reply = ask(state);
  fprintf('%.4f\n', 1e3 * toc(began));
end
