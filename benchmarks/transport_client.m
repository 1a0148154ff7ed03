% Milliseconds of each frame through GlRenderClient. Arguments: host, port, camera, output, count, JSON state.
given = argv();
[camera, output, count] = deal(given{end - 3}, given{end - 2}, str2double(given{end - 1}));
state = jsondecode(fileread(given{end}));
client = GlRenderClient(given{end - 5}, str2double(given{end - 4}), 'Timeout', 60);
for k = 1:count
  state.t_s = k;
  began = tic();
  reply = client.render(state, 'camera', camera, 'output', output);
  fprintf('%.4f\n', 1e3 * toc(began));
end
