% The tutorial of clients/simulink/README.md: a folder with block_1.m and so on, where its pictures and numbers go.
given = argv();
folder = given{end};
warning('off', 'all');                           % gnuplot is a toolkit that is discouraged
graphics_toolkit('gnuplot');
set(0, 'defaultfigurevisible', 'off');
for number = 1:numel(glob(fullfile(folder, 'block_*.m')))
  source(fullfile(folder, sprintf('block_%d.m', number)));
  if number == 3
    frame = reply;
  end
end
names = {'frame', 'range', 'loop'};
figures = sort(get(0, 'children'));
check(numel(figures) == numel(names), 'figures');
for number = 1:numel(names)
  set(figures(number), 'paperunits', 'inches', 'paperposition', [0 0 5.6 4.2]);
  print(figures(number), '-dpng', '-r80', fullfile(folder, ['tutorial_' names{number} '.png']));
end
file = fopen(fullfile(folder, 'found.json'), 'w');
fputs(file, jsonencode(struct('errors_px', errors_px, 'ranges_m', beam.arrays.range, 'dn_max', double(max(frame.pixels(:))), ...
                              'n_warnings', numel(frame.header.warnings), 'range_m', min(reply.arrays.range(:)))));
fclose(file);
printf('GLRENDER CHECKED\n');
