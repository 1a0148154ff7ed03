% Whose scene a frame shows. Arguments: host, port, JSON of two scenes and a state.
given = argv();
[host, port, told] = deal(given{end - 2}, str2double(given{end - 1}), jsondecode(fileread(given{end})));
[one, other, any_scene] = deal(GlRenderClient(host, port, 'Timeout', 60), GlRenderClient(host, port, 'Timeout', 60), ...
                               GlRenderClient(host, port, 'Timeout', 60));
where = {'camera', 'bare'};
scenes = told.scenes;
for k = 1:numel(scenes)
  scenes(k).bodies = {scenes(k).bodies};  % a list of one, which JSON's reader makes a struct
end
ahead = [0 0 1];

loaded = one.load_scene(scenes(1));
check(numel(loaded.scene) == 32, 'the digest');
bright = one.render(told.state, where{:});
check(strcmp(bright.header.scene, loaded.scene), 'a reply says what it shows');
several = one.render_frames(told.state, {struct('camera', 'bare')});
check(isequal(several{1}.pixels, bright.pixels), 'frames of it');
ranges = one.range(told.state, ahead, where{:});
check(strcmp(ranges.header.scene, loaded.scene) && isfinite(ranges.arrays.range), 'ranges of it');

of_other = other.load_scene(scenes(2)).scene;
check(~strcmp(of_other, loaded.scene), 'another scene has another digest');
dark = other.render(told.state, where{:});
check(sum(dark.pixels(:)) < 0.9 * sum(bright.pixels(:)), 'and other pixels');
expect_error('glrender:scene', of_other, @() one.render(told.state, where{:}));
expect_error('glrender:scene', of_other, @() one.render_frames(told.state, {struct('camera', 'bare')}));
expect_error('glrender:scene', of_other, @() one.range(told.state, ahead, where{:}));
shown = any_scene.render(told.state, where{:});
check(isequal(shown.pixels, dark.pixels), 'who has loaded none is shown what is served');
check(strcmp(shown.header.scene, of_other), 'and is told which it is');

one.load_scene(scenes(1));
check(isequal(one.render(told.state, where{:}).pixels, bright.pixels), 'loaded again');
expect_error('glrender:scene', loaded.scene, @() other.render(told.state, where{:}));
one.close();
other.close();
any_scene.close();
fprintf('GLRENDER CHECKED\n');
