function keep(folder, name, array)
  % The array's bytes in column-major order, for Python to compare.
  file = fopen(fullfile(folder, name), 'w', 'ieee-le');
  fwrite(file, array, class(array));
  fclose(file);
end
