function build_glrender_library(folder)
%BUILD_GLRENDER_LIBRARY  Make glrender_library.slx: three blocks that give a camera's frame.
%   Camera             Level-2 MATLAB S-function: needs nothing but MATLAB and Simulink
%   Camera System      MATLAB System block: the same, for those who prefer it
%   Camera C           C S-function, for Rapid Accelerator; build_glrender_mex compiles it
%   folder: where to save (default: this file's folder).
  if nargin < 1
    folder = fileparts(mfilename('fullpath'));
  end
  library = 'glrender_library';
  if bdIsLoaded(library)
    close_system(library, 0);
  end
  new_system(library, 'Library');
  defaults = glr_settings();
  names = fieldnames(defaults);
  source = 'simulink/User-Defined Functions/';

  blocks = {'Camera', 'Level-2 MATLAB S-Function', 'sfun_glrender'; 'Camera C', 'S-Function', 'sfun_glrender_c'};
  for k = 1:size(blocks, 1)
    block = [library, '/', blocks{k, 1}];
    add_block([source, blocks{k, 2}], block);
    set_param(block, 'FunctionName', blocks{k, 3});
    set_param(block, 'Parameters', strjoin(names.', ','));
    if strcmp(blocks{k, 3}, 'sfun_glrender_c')
      set_param(block, 'SFunctionModules', '''glr_client glr_request glr_reply glr_socket glr_wire''');
    end
    add_mask(block, defaults, names);
  end
  system_block = [library, '/Camera System'];
  add_block([source, 'MATLAB System'], system_block);
  set_param(system_block, 'System', 'GlRenderBlock');

  all_blocks = {'Camera', 'Camera System', 'Camera C'};
  for k = 1:numel(all_blocks)
    set_param([library, '/', all_blocks{k}], 'Position', [60, 120 * k - 60, 240, 120 * k + 20]);
  end
  save_system(library, fullfile(folder, [library, '.slx']));
  close_system(library, 0);
end

function add_mask(block, defaults, names)
  prompts = struct('Host', 'Server''s host', 'Port', 'Server''s TCP port', 'Camera', 'Camera''s name', ...
      'Bodies', 'Bodies'' names, separated by commas', 'PixelClass', 'uint8 or uint16 (digital numbers), single (W/m2)', ...
      'ImageSize', '[height width] in pixels', 'Exposure_s', 'Exposure [s]; 0: the camera''s', ...
      'Seed', 'Seed of the noise, 0 to 2^32 - 1', 'SampleTime', 'Sample time [s]', 'Timeout', 'Time limit of a frame [s]', ...
      'Deadline_s', 'Nothing more of a frame is begun after [s]; 0: none');
  mask = Simulink.Mask.create(block);
  for k = 1:numel(names)
    value = defaults.(names{k});
    if ischar(value)
      text = ['''', value, ''''];
    else
      text = mat2str(value);
    end
    mask.addParameter('Type', 'edit', 'Name', names{k}, 'Prompt', prompts.(names{k}), 'Value', text, ...
                      'Evaluate', 'on', 'Tunable', 'off');
  end
  set_param(block, 'MaskDisplay', ['port_label(''input'', 1, ''sun''); port_label(''input'', 2, ''spacecraft''); ', ...
            'port_label(''input'', 3, ''bodies''); port_label(''output'', 1, ''image''); ', ...
            'port_label(''output'', 2, ''facts'')']);
end
