% The golden messages of tests/data/golden.json, read and written by the MATLAB codec. Arguments: the file.
arguments_given = argv();
golden = jsondecode(fileread(arguments_given{end}));

% Requests: the very bytes, from MATLAB values in the same order.
state = struct();
state.t_s = 12.5;
state.r_sun_inertial_m = [1.5e11 0 0];
state.spacecraft = struct('r_inertial_m', [0 0 -2000], 'q_from_inertial', [1 0 0 0]);
state.bodies.body = struct('r_inertial_m', [0 0 0], 'q_from_inertial', [0.6 0 0 0.8]);
request = struct('v', uint8(1), 'id', uint64(7), 'client', 'golden', 'op', 'render');
request.state = state;
request.camera = 'navcam';
request.output = 'dn';
request.exposure_s = 0.1;
request.seed = uint64(7);
request.products = {'range'};
request.order = 'F';
check(isequal(glr_pack(request), from_hex(golden.request_render{1})), 'request_render differs');
check(isequal(glr_frame(glr_pack(request)), from_hex(golden.tcp_request_render{1})), 'tcp_request_render differs');
hello = struct('v', uint8(1), 'id', uint64(7), 'client', 'golden', 'op', 'hello');
check(isequal(glr_pack(hello), from_hex(golden.request_hello{1})), 'request_hello differs');

region = struct('v', uint8(1), 'id', uint64(7), 'client', 'golden', 'op', 'render');
region.state = state;
region.camera = 'navcam';
region.output = 'irradiance';
region.roi = uint8([2 1 5 3]);
check(isequal(glr_pack(region), from_hex(golden.request_region{1})), 'request_region differs');
compare = struct('v', uint8(1), 'id', uint64(7), 'client', 'golden', 'op', 'render');
compare.state = state;
compare.camera = 'navcam';
compare.exposure_s = 0.1;
compare.derivatives = {'spacecraft'};
compare.unknown = {'gain'};
compare.order = 'F';
pairs = glr_compare_pairs({'blur_px', 1.5, 'camera', 'c', 'compare', uint16([0 1 2; 3 4 5]), 'robust', true});
check(isequal(pairs(1:3), {'camera', 'c', 'compare'}) && numel(pairs) == 4, 'blur_px and robust go with the frame');
compare.compare = pairs{4};
check(isequal(glr_pack(compare), from_hex(golden.request_compare{1})), 'request_compare differs');
large = glr_pack(struct('bin', zeros(1, 70000, 'uint8')));
check(isequal(large(1:5), uint8([198 0 1 17 112])) && numel(large) == 70005, 'many bytes');
several = struct('v', uint8(1), 'id', uint64(7), 'client', 'golden', 'op', 'render');
several.state = state;
several.order = 'F';
first = struct('camera', 'navcam', 'output', 'dn', 'exposure_s', 0.1, 'seed', uint64(7));
first.products = {'range'};
several.frames = {first, struct('camera', 'wac', 'output', 'irradiance', 'roi', uint8([8 4 11 6]))};
check(isequal(glr_pack(several), from_hex(golden.request_frames{1})), 'request_frames differs');
check(isequal(glr_frame(glr_pack(several)), from_hex(golden.tcp_request_frames{1})), 'tcp_request_frames differs');

% Replies: header and arrays, in both orders.
image = uint16([0 1000 2000; 3000 4000 5000]);
range = reshape(linspace(1999, 2001, 6), 3, 2).';
for order = 'CF'
  parts = golden.(['reply_frame_', order]);
  header = glr_unpack(from_hex(parts{1}));
  check(header.ok && strcmp(header.unit, 'DN') && header.exposure_s == 0.1 && header.id == 7, 'header');
  first = glr_unpack(from_hex(parts{1}), 'arrays');
  check(isequal(fieldnames(first).', {'v', 'op', 'id', 'client', 'ok', 'arrays'}), 'the first six keys');
  check(isequal(first.arrays, header.arrays), 'arrays');
  check(isequal(header.arrays{2}.shape, [2 3]) && isa(header.arrays{2}.shape, 'double'), 'shape');
  first = glr_array(header.arrays{1}, from_hex(parts{2}));
  second = glr_array(header.arrays{2}, from_hex(parts{3}));
  check(isequal(first, image) && isa(first, 'uint16'), 'image, order %s', order);
  check(max(abs(second(:) - range(:))) < 1e-12 && isa(second, 'double'), 'range, order %s', order);
end
for order = 'CF'
  parts = golden.(['reply_frames_', order]);
  header = glr_unpack(from_hex(parts{1}));
  check(isequal(cellfun(@(entry) entry.frame, header.arrays), [0 0 1]), 'frames of the arrays, order %s', order);
  check(strcmp(header.frames{2}.camera, 'wac') && isequal(header.frames{2}.roi, [8 4 11 6]), 'frames');
  second = glr_array(header.arrays{2}, from_hex(parts{3}));
  third = glr_array(header.arrays{3}, from_hex(parts{4}));
  check(isequal(glr_array(header.arrays{1}, from_hex(parts{2})), image), 'image of the first, order %s', order);
  check(max(abs(second(:) - range(:))) < 1e-12, 'range of the first, order %s', order);
  check(isequal(third, single([0.5 0.25 0.125; 1 2 4])), 'image of the second, order %s', order);
end
parts = golden.reply_region;
header = glr_unpack(from_hex(parts{1}));
check(isequal(header.roi, [2 1 5 3]) && ~isfield(header.arrays{1}, 'frame'), 'region');
check(isequal(glr_array(header.arrays{1}, from_hex(parts{2})), single([0.5 0.25 0.125; 1 2 4])), 'pixels of the region');
found = glr_unpack(from_hex(golden.reply_compared{1})).comparison;
check(isequal(found.names, {'law.normal_albedo', 'gain'}) && found.chi2 == 7.25, 'a comparison');
check(isequal(reshape([found.matrix{:}], 2, 2), [4 0.5; 0.5 2]), 'its matrix');
parts = golden.reply_compressed;
header = glr_unpack(from_hex(parts{1}));
check(strcmp(header.codec, 'jpeg_ls') && isequal(header.shape, [2 3]) && header.bit_depth == 16, 'for a decoder');
check(isequal(glr_array(header.arrays{1}, from_hex(parts{2})), reshape(from_hex(parts{2}), [], 1)), 'stream');
parts = golden.reply_warned;
header = glr_unpack(from_hex(parts{1}));
check(numel(header.warnings) == 2 && strcmp(header.warnings{2}.code, 'sun_distance'), 'warnings');
check(strcmp(header.warnings{1}.message, 'body is behind the camera'), 'the text of a warning');
check(isequal(glr_array(header.arrays{1}, from_hex(parts{2})), single([0.5 0.25 0.125; 1 2 4])), 'pixels with warnings');
shared = struct('v', uint8(1), 'id', uint64(7), 'client', 'golden', 'op', 'render', 'shared', true);
for name = {'state', 'camera', 'output', 'exposure_s', 'seed', 'products', 'order'}
  shared.(name{1}) = request.(name{1});
end
check(isequal(glr_pack(shared), from_hex(golden.request_shared{1})), 'request_shared differs');
% Its pixels, in a file as a server writes it, but under a name of this process.
header = glr_unpack(from_hex(golden.reply_shared{1}), 'arrays');
check(isequal(header.shared.name, 'glrender-slot-golden') && header.shared.number == 300, 'shared');
[~, unique] = fileparts(tempname());
header.shared.name = ['glrender-slot-golden-', lower(unique)];
file = fopen(['/dev/shm/', header.shared.name], 'w');
fwrite(file, from_hex(golden.slot_shared{1}), 'uint8');
fclose(file);
parts = glr_shared(header.shared);
check(isequal(glr_array(header.arrays{1}, parts{1}), image), 'image in shared memory');
check(max(abs(glr_array(header.arrays{2}, parts{2})(:) - range(:))) < 1e-12, 'range in shared memory');
header.shared.number = 301;
check(isempty(glr_shared(header.shared)), 'another frame is none');
delete(['/dev/shm/', header.shared.name]);
header.shared.number = 300;
check(isempty(glr_shared(header.shared)), 'what is gone is none');
header = glr_unpack(from_hex(golden.reply_error{1}));
check(~header.ok && strcmp(header.error.code, 'config') && strcmp(header.error.path, 'state.gamma'), 'error reply');

% Values there and back.
values = {0, -0.5, 1e300, true, false, 'text', repmat('x', 1, 40), repmat('y', 1, 300), [], ...
          {'a', 'b'}, {}, [1 2 3], num2cell(1:3), repmat({'z'}, 1, 20), uint8(200)};
expected = values;
expected{13} = [1 2 3];
expected{15} = 200;
expected{11} = cell(1, 0);
for k = 1:numel(values)
  check(isequal(glr_unpack(glr_pack(values{k})), expected{k}), 'value %d does not come back', k);
end
for number = {int8(-1), int8(-32), int8(-33), int32(-2 ^ 31), uint16(65535), uint32(2 ^ 32 - 1), uint8(127), uint8(128)}
  check(isequal(glr_unpack(glr_pack(number{1})), double(number{1})), '%d does not come back', number{1});
end
largest = intmax('uint64');
check(isequal(glr_unpack(glr_pack(largest)), largest) && isa(glr_unpack(glr_pack(largest)), 'uint64'), 'uint64');
check(isequal(glr_unpack(glr_pack([1 2; 3 4])), {[1 2], [3 4]}), 'matrix as a list of its rows');
check(isequal(glr_unpack(glr_pack(single(0.1))), double(single(0.1))), 'single');
umlaut = native2unicode(uint8([103 195 182]), 'UTF-8');
check(isequal(glr_unpack(glr_pack(umlaut)), umlaut), 'UTF-8');
map = containers.Map();
map('67P') = struct('t', 1);
check(isequal(glr_pack(map), uint8([129 163 double('67P') 129 161 double('t') 203 63 240 zeros(1, 6)])), 'Map');
check(glr_unpack(uint8([129 163 double('a-b') 1])).a_b == 1, 'a key that is no MATLAB name');
check(isequal(glr_unpack(uint8([196 2 7 8])), uint8([7 8])), 'binary');
check(glr_unpack(uint8([202 63 128 0 0])) == 1, 'float32');
check(glr_unpack(uint8([209 255 0])) == -256, 'int16');
check(isequal(size(glr_unpack(uint8([220 0 2 1 2]))), [1 2]), 'array 16');
long = glr_pack(repmat({true}, 1, 65536));
check(numel(glr_unpack(long)) == 65536, 'array 32');

% States packed like the one before, and whatever breaks the likeness: always what glr_pack gives.
form = [];
other = state;
other.spacecraft.r_inertial_m = [NaN; -Inf; -0];
moving = other;
moving.spacecraft.v_inertial_m_s = [1 2 3];
single_state = state;
single_state.t_s = single(2);
flag = state;
flag.t_s = true;
swapped = state;
swapped.spacecraft = struct('r_inertial_m', [1 0 0 0], 'q_from_inertial', [0 0 -2000]);
square = state;
square.spacecraft.q_from_inertial = eye(2);
nobody = state;
nobody.bodies = struct();
emptied = state;
emptied.r_sun_inertial_m = [];
mapped = state;
mapped.bodies = containers.Map();
mapped.bodies('67P') = state.bodies.body;
twice = repmat(state, 1, 2);
for value = {state, other, state, moving, moving, other, single_state, state, flag, state, swapped, state, square, ...
             square, state, nobody, nobody, emptied, state, mapped, mapped, other}
  [bytes, form] = glr_pack_like(value{1}, form);
  check(isequal(bytes, glr_pack(value{1})), 'not what glr_pack gives');
end
[bytes, ~] = glr_pack_like(orderfields(other, [4 3 2 1]), form);
check(isequal(bytes, glr_pack(other)), 'in the order of the first');
expect_error('glrender:pack', '.', @() glr_pack_like(twice, form));
kept = [];
for k = 1:20
  value = state;
  value.t_s = k;
  pairs = {'client', 'golden', 'op', 'render', 'camera', repmat('c', 1, mod(k, 3) + 1), 'seed', uint64(floor(k / 4))};
  if mod(k, 5) == 0
    pairs = pairs(1:6);
    value = [];
  end
  [bytes, kept] = glr_request(kept, 250 + k, pairs, value);
  read = glr_unpack(bytes(13:end));
  check(isequal(bytes(1:8), [uint8('GLR1') 1 0 0 0]) && typecast(bytes(9:12), 'uint32') == numel(bytes) - 12, 'frame');
  check(read.v == 1 && read.id == 250 + k && strcmp(read.camera, pairs{6}) && strcmp(read.client, 'golden'), 'fields');
  check(isfield(read, 'seed') == (numel(pairs) > 6) && isfield(read, 'state') == ~isempty(value), 'no other fields');
  check(isempty(value) || (isequal(read.state, glr_unpack(glr_pack(value))) && read.seed == floor(k / 4)), 'state');
end

% Headers read like the one before: always what glr_unpack gives.
kept = [];
given = {};
for name = {'reply_frame_F', 'reply_shared', 'reply_frame_C', 'reply_frames_F', 'reply_error', 'reply_hello'}
  if isfield(golden, name{1})
    given{end + 1} = from_hex(golden.(name{1}){1});
  end
end
check(numel(given) > 4, 'golden replies');
rest = {'client', 'golden', 'ok', true, 'arrays', {struct('name', 'image', 'part', uint8(1))}, 't_s', 2};
rest = cellfun(@glr_pack, rest, 'UniformOutput', false);
for number = [0 127 128 255 256 65536 2 ^ 32 2 ^ 40]
  for id = [7 255 65535 65536]
    own = [glr_pack('v'), uint8(1), glr_pack('op'), glr_pack('render'), glr_pack('id'), minimal(id), rest{:}];
    for slot = {'glrender-slot-golden', 'glrender-slot-another', repmat('x', 1, 40), repmat('y', 1, 40)}
      pairs = {[glr_pack('name'), glr_pack(slot{1})], [glr_pack('number'), minimal(number)], ...
               [glr_pack('offsets'), uint8([146 64 204 128])], [glr_pack('sizes'), uint8([146 12 48])]};
      if slot{1}(1) == 'y'
        pairs = pairs([2 1 3 4]);
        given{end + 1} = [uint8(135), own];
      end
      given{end + 1} = [uint8([222 0 8]), glr_pack('shared'), uint8(132), pairs{:}, own];
    end
  end
end
for k = [1:numel(given), numel(given):-1:1, repmat([1 2], 1, 5)]
  [header, kept] = glr_header(given{k}, kept);
  check(isequal(header, glr_unpack(given{k}, 'arrays')), 'header %d', k);
end
% Both were by the short way, or they were for nothing.
form.bytes(1) = 0;
check(glr_pack_like(other, form)(1) == 0, 'packed anew');
[~, kept] = glr_header(given{end - 9}, kept);
kept.header.op = 'kept';
kept.place.place.sizes = 5;
header = glr_header(given{end - 9}, kept);
check(strcmp(header.op, 'kept') && header.id == 65535 && header.shared.sizes == 5, 'read anew');
check(header.shared.number == 2 ^ 40 && strcmp(header.shared.name, 'glrender-slot-golden'), 'where it is now');

% What is no message.
whole = from_hex(golden.request_render{1});
for count = [0:120, 123:3:numel(whole) - 1]
  expect_error('glrender:protocol', '.', @() glr_unpack(whole(1:count)));
end
expect_error('glrender:protocol', 'type 193', @() glr_unpack(uint8(193)));
expect_error('glrender:protocol', 'has 2 bytes', @() glr_unpack(uint8([1 1])));
expect_error('glrender:protocol', 'text keys', @() glr_unpack(uint8([129 1 1])));
expect_error('glrender:protocol', 'a list of 4294967295', @() glr_unpack(uint8([221 255 255 255 255])));
expect_error('glrender:pack', 'cannot be sent', @() glr_pack(zeros(2, 2, 2)));
expect_error('glrender:pack', 'real', @() glr_pack(1 + 2i));
expect_error('glrender:pack', 'a row', @() glr_pack(['ab'; 'cd']));
entry = struct('name', 'image', 'dtype', 'uint16', 'shape', [2 3], 'order', 'F');
expect_error('glrender:protocol', '11 bytes are no', @() glr_array(entry, zeros(1, 11, 'uint8')));
fprintf('GLRENDER CHECKED\n');
