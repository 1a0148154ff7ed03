function settings = glr_settings(values)
%GLR_SETTINGS  The eleven parameters of a block, in their order, checked; a struct.
%   Host, Port, Camera, Bodies ('didymos,dimorphos'), PixelClass, ImageSize, Exposure_s, Seed, SampleTime, Timeout,
%   Deadline_s.
%   Without an argument: the defaults. Errors: glrender:argument.
  names = {'Host', 'Port', 'Camera', 'Bodies', 'PixelClass', 'ImageSize', 'Exposure_s', 'Seed', 'SampleTime', 'Timeout', ...
           'Deadline_s'};
  if nargin < 1
    values = {'127.0.0.1', 5556, 'navcam', 'body', 'uint16', [1024 1024], 0, 0, 0.1, 10, 0};
  end
  if numel(values) ~= numel(names)
    error('glrender:argument', 'the block has %d parameters, not %d', numel(names), numel(values));
  end
  settings = cell2struct(reshape(values, [], 1), names, 1);
  rule(ischar(settings.Host) && ~isempty(settings.Host), 'Host must be text');
  rule(is_number(settings.Port) && settings.Port >= 1 && settings.Port <= 65535, 'Port must be 1 to 65535');
  rule(ischar(settings.Camera) && ~isempty(settings.Camera), 'Camera must be text');
  rule(ischar(settings.Bodies) && ~isempty(settings.Bodies), 'Bodies must be names, separated by commas');
  rule(any(strcmp(settings.PixelClass, {'uint8', 'uint16', 'single'})), 'PixelClass must be uint8, uint16 or single');
  rule(isnumeric(settings.ImageSize) && numel(settings.ImageSize) == 2 && all(settings.ImageSize >= 1), ...
       'ImageSize must be [height width] in pixels');
  rule(is_number(settings.Exposure_s) && settings.Exposure_s >= 0, 'Exposure_s must be >= 0 [s]; 0 is the camera''s');
  rule(is_number(settings.Seed) && settings.Seed >= 0 && settings.Seed < 2^32 && settings.Seed == fix(settings.Seed), ...
       sprintf('Seed must be an integer from 0 to 2^32 - 1, got %s', disp_of(settings.Seed)));
  rule(is_number(settings.SampleTime) && settings.SampleTime > 0, 'SampleTime must be > 0 [s]');
  rule(is_number(settings.Timeout) && settings.Timeout > 0, 'Timeout must be > 0 [s]');
  rule(is_number(settings.Deadline_s) && settings.Deadline_s >= 0, 'Deadline_s must be >= 0 [s]; 0 is none');
end

function rule(holds, text)
  if ~holds
    error('glrender:argument', '%s', text);
  end
end

function text = disp_of(value)
  text = class(value);
  if isnumeric(value)
    text = mat2str(value, 17);
  end
end

function yes = is_number(value)
  yes = isnumeric(value) && isscalar(value) && isreal(value);
end
