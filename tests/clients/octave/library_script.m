% build_glrender_library and build_example_model with recording stand-ins. Arguments: clients/simulink.
given = argv();
sources = given{end};
build_glrender_library('/somewhere');
calls = recorded();
of = @(name) calls(cellfun(@(c) strcmp(c{1}, name), calls));
get = @(list, block, what) list{cellfun(@(c) strcmp(c{2}, block) && any(strcmp(c(3:2:end), what)), list)};
added = cellfun(@(c) c{3}, of('add_block'), 'UniformOutput', false);
check(isequal(sort(added), {'glrender_library/Camera', 'glrender_library/Camera C', 'glrender_library/Camera System'}), ...
      'blocks');
first = of('new_system');
check(isequal(first{1}, {'new_system', 'glrender_library', 'Library'}), 'a library');
saved = of('save_system');
check(isequal(saved{1}{3}, '/somewhere/glrender_library.slx'), 'saved');

masks = of('addParameter');
for name = {'Camera', 'Camera C'}
  block = ['glrender_library/', name{1}];
  own = masks(cellfun(@(c) strcmp(c{2}, block), masks));
  options = cellfun(@(c) struct(c{3:end}), own);
  list = get(of('set_param'), block, 'Parameters');
  check(isequal(strjoin({options.Name}, ','), list{4}), 'the mask''s names are the S-function''s parameters');
  s_function = get(of('set_param'), block, 'FunctionName');
  check(exist(fullfile(sources, [s_function{4}, '.m']), 'file') == 2 ...
        || exist(fullfile(sources, [s_function{4}, '.c']), 'file') == 2, 'no file of %s', s_function{4});
  % The defaults, evaluated as Simulink evaluates a mask, make a block that sets itself up.
  values = cellfun(@eval, {options.Value}, 'UniformOutput', false);
  block = FakeBlock(1, values);
  block.set_up(@sfun_glrender);
  check(isequal(block.OutputPort(1).Dimensions, [1024 1024]) && block.OutputPort(1).DatatypeID == 5, 'defaults');
  check(isequal(glr_settings(values), glr_settings()), 'the mask''s defaults are those of glr_settings');
end
system = get(of('set_param'), 'glrender_library/Camera System', 'System');
properties_of = GlRenderBlock();
defaults = glr_settings();
for name = fieldnames(defaults).'
  check(isequal(properties_of.(name{1}), defaults.(name{1})), 'default of %s', name{1});
end
check(exist(fullfile(sources, [system{4}, '.m']), 'file') == 2, 'no file of %s', system{4});
modules = get(of('set_param'), 'glrender_library/Camera C', 'SFunctionModules');
for name = strsplit(eval(modules{4}), ' ')
  check(exist(fullfile(sources, [name{1}, '.c']), 'file') == 2, 'no file of %s', name{1});
end

recorded('clear');
build_example_model('/somewhere');
calls = recorded();
of = @(name) calls(cellfun(@(c) strcmp(c{1}, name), calls));
blocks = cellfun(@(c) strrep(c{3}, 'glrender_example/', ''), of('add_block'), 'UniformOutput', false);
n_in = struct('Sun', 0, 'Spacecraft', 0, 'Body', 0, 'Camera', 3, 'Frames', 1);
wired = {};
lines = of('add_line');
for k = 1:numel(lines)
  from = strsplit(lines{k}{3}, '/');
  to = strsplit(lines{k}{4}, '/');
  check(any(strcmp(from{1}, blocks)) && any(strcmp(to{1}, blocks)), 'a line between blocks that are there');
  check(str2double(from{2}) == 1 && str2double(to{2}) <= n_in.(to{1}), 'a port that is there');
  wired{end + 1} = lines{k}{4}; %#ok<AGROW>
end
check(numel(unique(wired)) == sum(cell2mat(struct2cell(n_in))), 'every input has one line');
camera = calls{cellfun(@(c) strcmp(c{1}, 'add_block') && strcmp(c{2}, 'glrender_library/Camera'), calls)};
check(all(ismember(camera(4:2:end), fieldnames(defaults))), 'parameters that the mask has');
fprintf('GLRENDER CHECKED\n');
