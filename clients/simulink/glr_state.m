function state = glr_state(names, t_s, r_sun_inertial_m, spacecraft, bodies)
%GLR_STATE  The state struct of a request, from the signals of a block.
%   names: cell of body names; spacecraft: 7 numbers, r_inertial_m then q_from_inertial [w x y z]
%   (the conjugate of Aerospace Blockset's quaternion);
%   bodies: 7 numbers for each name, one after the other.
  bodies = reshape(double(bodies), 7, []);
  if size(bodies, 2) ~= numel(names)
    error('glrender:argument', '%d bodies are named, %d poses given', numel(names), size(bodies, 2));
  end
  if all(cellfun(@isvarname, names))
    poses = struct();
    for k = 1:numel(names)
      poses.(names{k}) = pose(bodies(:, k));
    end
  else
    poses = containers.Map();
    for k = 1:numel(names)
      poses(names{k}) = pose(bodies(:, k));
    end
  end
  state = struct('t_s', double(t_s), 'r_sun_inertial_m', reshape(double(r_sun_inertial_m), 1, 3), ...
                 'spacecraft', pose(spacecraft), 'bodies', poses);
end

function value = pose(numbers)
  numbers = reshape(double(numbers), 1, 7);
  value = struct('r_inertial_m', numbers(1:3), 'q_from_inertial', numbers(4:7));
end
