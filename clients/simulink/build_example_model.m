function build_example_model(folder)
%BUILD_EXAMPLE_MODEL  Make glrender_example.slx: a fly-by whose frames go to the workspace as `frames`.
%   The trajectory is read from the workspace variable `spacecraft` (timeseries or [t, 7 columns]); the Sun and the
%   body stand still. Needs glrender_library on the path (build_glrender_library). folder: where to save (default: here).
  if nargin < 1
    folder = pwd();
  end
  model = 'glrender_example';
  if bdIsLoaded(model)
    close_system(model, 0);
  end
  load_system('glrender_library');
  new_system(model);
  add_block('simulink/Sources/Constant', [model, '/Sun'], 'Value', '[1.5e11 0 0]');
  add_block('simulink/Sources/From Workspace', [model, '/Spacecraft'], 'VariableName', 'spacecraft');
  add_block('simulink/Sources/Constant', [model, '/Body'], 'Value', '[0 0 0 1 0 0 0]');
  add_block('glrender_library/Camera', [model, '/Camera'], 'Bodies', '''body''', 'PixelClass', '''uint16''', ...
            'ImageSize', '[1024 1024]', 'SampleTime', '1');
  add_block('simulink/Sinks/To Workspace', [model, '/Frames'], 'VariableName', 'frames', 'SaveFormat', 'Array', ...
            'MaxDataPoints', '100');
  blocks = {'Sun', 'Spacecraft', 'Body'};
  for k = 1:3
    set_param([model, '/', blocks{k}], 'Position', [40, 80 * k - 40, 140, 80 * k]);
    add_line(model, [blocks{k}, '/1'], sprintf('Camera/%d', k));
  end
  set_param([model, '/Camera'], 'Position', [220, 60, 380, 240]);
  set_param([model, '/Frames'], 'Position', [460, 130, 560, 170]);
  add_line(model, 'Camera/1', 'Frames/1');
  set_param(model, 'SolverType', 'Fixed-step', 'FixedStep', '1', 'StopTime', '20');
  save_system(model, fullfile(folder, [model, '.slx']));
  close_system(model, 0);
end
