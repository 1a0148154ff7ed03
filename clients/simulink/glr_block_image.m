function [image, facts] = glr_block_image(client, settings, state, n_frames)
%GLR_BLOCK_IMAGE  The image of one step of a block, checked against what the block declares, and its facts.
%   settings: Camera, PixelClass ('uint8', 'uint16': digital numbers; 'single': irradiance), ImageSize [height width],
%   Exposure_s (0: the camera's), Seed (whole, below 2^32; frames of two seeds share no noise). n_frames: frames so far. Deadline_s (0: none).
%   facts (4): predicted error; exposure [s], NaN of irradiance; 1 where the frame took longer than Deadline_s; number of
%   its warnings.
  options = {'camera', settings.Camera};
  if strcmp(settings.PixelClass, 'single')
    options = [options, {'output', 'irradiance'}];
  else
    options = [options, {'output', 'dn', 'seed', uint64(settings.Seed) * uint64(2)^32 + uint64(n_frames)}];
    if settings.Exposure_s > 0
      options = [options, {'exposure_s', settings.Exposure_s}];
    end
  end
  if settings.Deadline_s > 0
    options = [options, {'deadline_s', settings.Deadline_s}];
  end
  reply = client.render(state, options{:});
  tell(reply.header.warnings, n_frames);
  image = reply.pixels;
  facts = [reply.header.plan.predicted_error; field(reply.header, 'exposure_s', NaN); ...
           field(reply.header, 'is_late', 0); numel(reply.header.warnings)];
  if ~isa(image, settings.PixelClass) || ~isequal(size(image), reshape(settings.ImageSize, 1, []))
    error('glrender:size', 'camera %s gives %s %s, the block expects %s %s', settings.Camera, mat2str(size(image)), ...
          class(image), mat2str(settings.ImageSize), settings.PixelClass);
  end
end

function value = field(header, name, absent)
  value = absent;
  if isfield(header, name)
    value = double(header.(name));
  end
end

function tell(warnings, n_frames)
  % Each kind of warning once in a simulation: warning('off', 'glrender:saturated') silences one.
  persistent told
  if n_frames == 0 || isempty(told)
    told = {};
  end
  for k = 1:numel(warnings)
    if ~any(strcmp(warnings{k}.code, told))
      told{end + 1} = warnings{k}.code;
      warning(['glrender:', warnings{k}.code], '%s', warnings{k}.message);
    end
  end
end
