% The Simulink blocks with stand-ins for Simulink, against a live server. Arguments: host, port, folder, JSON state.
given = argv();
[host, port, folder] = deal(given{end - 3}, str2double(given{end - 2}), given{end - 1});
state = jsondecode(fileread(given{end}));
flat = @(pose) [pose.r_inertial_m(:); pose.q_from_inertial(:)];
signals = {state.r_sun_inertial_m(:), flat(state.spacecraft), flat(state.bodies.body)};

% Level-2 S-function: three classes, three steps each, as Simulink would call it; two blocks at once.
cases = {'navcam', 'uint16', [64 96], 0.02; 'byte', 'uint8', [40 48], 0; 'navcam', 'single', [64 96], 0};
for k = 1:size(cases, 1)
  [camera, kind, shape, exposure] = cases{k, :};
  block = FakeBlock(100.5 + k, {host, port, camera, 'body', kind, shape, exposure, 7, 0.5, 20, 0});
  block.set_up(@sfun_glrender);
  check(isequal(block.SampleTimes, [0.5 0]), 'sample time');
  block.call('CheckParameters');
  block.call('Start');
  twin = FakeBlock(200.5 + k, {host, port, 'bare', 'body', 'single', [32 32], 0, 0, 1, 20, 0});
  twin.set_up(@sfun_glrender);
  twin.call('Start');
  for step = 0:2
    [image, facts] = block.output_at(0.5 * step, signals{:});
    check(facts(1) > 0 && facts(1) < 1 && isnan(facts(2)) == strcmp(kind, 'single') && facts(3) == 0, 'facts');
    check(isequal(size(twin.output_at(step, signals{:})), [32 32]), 'the other block');
    keep(folder, sprintf('level2_%d_%d', k, step), image);
  end
  block.call('Terminate');
  check(isempty(glr_block_store(100.5 + k)), 'nothing is kept after Terminate');
  check(~isempty(glr_block_store(200.5 + k)), 'the other block is kept');
  twin.call('Terminate');
  block.call('Terminate');
end

% The same frames by the System block.
for k = 1:size(cases, 1)
  [camera, kind, shape, exposure] = cases{k, :};
  block = GlRenderBlock('Host', host, 'Port', port, 'Camera', camera, 'PixelClass', kind, 'ImageSize', shape, ...
                        'Exposure_s', exposure, 'Seed', 7, 'SampleTime', 0.5, 'Timeout', 20);
  check(isequal(block.declared().inputs, {'r_sun_inertial_m', 'spacecraft', 'bodies'}), 'names of the inputs');
  check(isequal(block.declared().outputs, {'image', 'facts'}), 'names of the outputs');
  check(strcmp(block.declared().sample_time.Type, 'Discrete') && block.declared().sample_time.SampleTime == 0.5, 'time');
  for step = 0:2
    if step > 0
      block.simulate_time(0.5 * step);
    end
    [image, facts] = block.step(signals{:});
    check(numel(facts) == 4 && facts(1) > 0, 'facts');
    keep(folder, sprintf('system_%d_%d', k, step), image);
  end
  block.release();
  block.release();
end

% A block says what is odd in its frames: here that they are saturated.
lastwarn('', '');
block = FakeBlock(900.5, {host, port, 'navcam', 'body', 'uint16', [64 96], 10, 7, 0.5, 20, 1e-6});
block.set_up(@sfun_glrender);
block.call('Start');
[~, facts] = block.output_at(0, signals{:});
[message, identifier] = lastwarn();
check(strcmp(identifier, 'glrender:saturated') && ~isempty(strfind(message, 'saturated')), 'a warning: %s', identifier);
check(facts(2) == 10 && facts(3) == 1 && facts(4) >= 1, 'facts: %s', mat2str(facts, 6));
block.call('Terminate');

% What goes wrong stops the simulation with a message.
base = {host, port, 'navcam', 'body', 'uint16', [64 96], 0, 7, 0.5, 20, 0};
wrong = {3, 'wac', 'glrender:scene', 'unknown camera'; 5, 'uint8', 'glrender:size', 'the block expects \[64 96\] uint8'; ...
         6, [96 64], 'glrender:size', 'gives \[64 96\]'; 2, 1, 'glrender:connection', 'no server'; ...
         4, 'moon', 'glrender:scene', 'state.bodies'};
for k = 1:size(wrong, 1)
  parameters = base;
  parameters{wrong{k, 1}} = wrong{k, 2};
  expect_error(wrong{k, 3}, wrong{k, 4}, @() run_once(parameters, signals));
end
refused = {2, 0; 3, ''; 4, ''; 5, 'double'; 6, 64; 6, [0 5]; 7, -1; 7, NaN; 8, -1; 9, 0; 9, NaN; 10, 0; 11, -1; 11, NaN; 1, 7};
for k = 1:size(refused, 1)
  parameters = base;
  parameters{refused{k, 1}} = refused{k, 2};
  expect_error('glrender:argument', '.', @() FakeBlock(1, parameters).set_up(@sfun_glrender));
end
for seed = [2^32, 2^53, -1, 0.5, NaN]
  parameters = base;
  parameters{8} = seed;
  expect_error('glrender:argument', sprintf('Seed must be an integer from 0 to 2\\^32 - 1, got %s$', mat2str(seed, 17)), ...
               @() FakeBlock(1, parameters).set_up(@sfun_glrender));
end
expect_error('glrender:argument', '2 bodies are named, 1 poses', ...
             @() glr_state({'a', 'b'}, 0, [1 0 0], ones(7, 1), ones(7, 1)));

% The example closed loop: the body comes to the centre and stays.
client = GlRenderClient(host, port);
errors_px = example_closed_loop(client, 15);
fprintf('closed loop: %s px\n', mat2str(errors_px, 3));
client.close();
check(errors_px(1) > 10, 'it starts off the centre');
check(max(errors_px(end - 4:end)) < 6 && max(errors_px(end - 4:end)) < errors_px(1) / 2, 'it converges');
fprintf('GLRENDER CHECKED\n');
