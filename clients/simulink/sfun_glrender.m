function sfun_glrender(block)
%SFUN_GLRENDER  Level-2 MATLAB S-function: a camera's frame per sample time, from a glrender server.
%   Inputs: r_sun_inertial_m (3) [m]; spacecraft (7): r_inertial_m [m], q_from_inertial [w x y z]
%   (the conjugate of Aerospace Blockset's quaternion);
%   bodies (7 for each): the same, in the order of Bodies. Outputs: the image, height x width, row 1 on top;
%   facts (4), as of glr_block_image: predicted error, exposure [s], whether it is late, number of warnings.
%   Parameters: those of glr_settings. Time is the simulation's. An error of the server stops the simulation.
  setup(block);
end

function setup(block)
  block.NumDialogPrms = 11;
  block.DialogPrmsTunable = repmat({'Nontunable'}, 1, 11);
  settings = settings_of(block);
  block.NumInputPorts = 3;
  block.NumOutputPorts = 2;
  block.SetPreCompInpPortInfoToDynamic;
  block.SetPreCompOutPortInfoToDynamic;
  widths = [3, 7, 7 * numel(strsplit(settings.Bodies, ','))];
  for k = 1:3
    block.InputPort(k).Dimensions = widths(k);
    block.InputPort(k).DatatypeID = 0;  % double
    block.InputPort(k).Complexity = 'Real';
    block.InputPort(k).SamplingMode = 'Sample';
    block.InputPort(k).DirectFeedthrough = true;
  end
  ids = struct('single', 1, 'uint8', 3, 'uint16', 5);
  block.OutputPort(1).Dimensions = reshape(double(settings.ImageSize), 1, 2);
  block.OutputPort(1).DatatypeID = ids.(settings.PixelClass);
  block.OutputPort(2).Dimensions = 4;
  block.OutputPort(2).DatatypeID = 0;
  for k = 1:2
    block.OutputPort(k).Complexity = 'Real';
    block.OutputPort(k).SamplingMode = 'Sample';
  end
  block.SampleTimes = [settings.SampleTime 0];
  block.SimStateCompliance = 'DisallowSimState';
  block.SetAccelRunOnTLC(false);
  block.RegBlockMethod('CheckParameters', @settings_of);
  block.RegBlockMethod('SetInputPortSamplingMode', @set_sampling_mode);
  block.RegBlockMethod('Start', @start);
  block.RegBlockMethod('Outputs', @outputs);
  block.RegBlockMethod('Terminate', @terminate);
end

function settings = settings_of(block)
  values = cell(1, 11);
  for k = 1:11
    values{k} = block.DialogPrm(k).Data;
  end
  settings = glr_settings(values);
end

function set_sampling_mode(block, port, mode)
  block.InputPort(port).SamplingMode = mode;
end

function start(block)
  settings = settings_of(block);
  client = GlRenderClient(settings.Host, settings.Port, 'Timeout', settings.Timeout);
  glr_block_store(block.BlockHandle, struct('client', client, 'settings', settings, 'n_frames', 0));
end

function outputs(block)
  kept = glr_block_store(block.BlockHandle);
  state = glr_state(strsplit(kept.settings.Bodies, ','), block.CurrentTime, block.InputPort(1).Data, ...
                    block.InputPort(2).Data, block.InputPort(3).Data);
  [block.OutputPort(1).Data, block.OutputPort(2).Data] = glr_block_image(kept.client, kept.settings, state, kept.n_frames);
  kept.n_frames = kept.n_frames + 1;
  glr_block_store(block.BlockHandle, kept);
end

function terminate(block)
  kept = glr_block_store(block.BlockHandle);
  if ~isempty(kept)
    kept.client.close();
    glr_block_store(block.BlockHandle, []);
  end
end
