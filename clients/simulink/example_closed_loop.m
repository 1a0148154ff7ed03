function errors_px = example_closed_loop(client, n_steps)
%EXAMPLE_CLOSED_LOOP  A spacecraft drifts and keeps the first body in the image's centre by what its camera sees.
%   client = GlRenderClient(); errors_px = example_closed_loop(client, 20);
%   Each step: a frame, the centre of brightness, a turn of 80 % of the angle measured.
%   errors_px: the body's true distance from the image's centre at each frame [px].
  hello = client.hello();
  camera = hello.cameras{1};
  body = hello.bodies{1};
  f = camera.focal_length_px;
  range_m = 5 * body.radius_m * f / min(camera.width_px, camera.height_px);
  r = [0 0 -range_m];
  velocity = [0.0005 0.0003 0] * range_m;              % per step, across the line of sight
  q = normalised([1 0.4 * camera.height_px / f / 2 -0.4 * camera.width_px / f / 2 0]);
  errors_px = zeros(1, n_steps);
  for k = 1:n_steps
    poses = containers.Map();
    for j = 1:numel(hello.bodies)
      poses(hello.bodies{j}.name) = struct('r_inertial_m', [0 0 0] + (j > 1) * 1e3 * range_m, 'q_from_inertial', [1 0 0 0]);
    end
    state = struct('t_s', k, 'r_sun_inertial_m', [1e11 0 -1.1e11], 'bodies', poses, ...
                   'spacecraft', struct('r_inertial_m', r, 'q_from_inertial', q));
    reply = client.render(state, 'camera', camera.name);
    truth = turned(q, -r);
    offset = f * truth(1:2) / truth(3) + camera.principal_point_px ...
             - [camera.width_px - 1, camera.height_px - 1] / 2;
    errors_px(k) = norm(offset);

    image = double(reply.pixels);
    [x, y] = meshgrid(0:camera.width_px - 1, 0:camera.height_px - 1);
    seen = [sum(x(:) .* image(:)), sum(y(:) .* image(:))] / sum(image(:));
    aside = 0.8 * (seen - camera.principal_point_px) / f;   % [rad]: to the right, down
    % +Z turns to the right about +Y, and down about -X.
    turn = normalised([1, aside(2) / 2, -aside(1) / 2, 0]);
    q = normalised(product(turn, q));
    r = r + velocity;
  end
end

function v = turned(q, v)
  % Components of v in the frame that q leads to: q_from_inertial as in docs/conventions.md.
  w = q(1);
  u = q(2:4);
  v = v + 2 * cross(u, cross(u, v) + w * v);
end

function r = product(p, q)
  % First q, then p.
  r = [p(1) * q(1) - dot(p(2:4), q(2:4)), p(1) * q(2:4) + q(1) * p(2:4) + cross(p(2:4), q(2:4))];
end

function q = normalised(q)
  q = q / norm(q);
end
