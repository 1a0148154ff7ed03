% Compiles glrender_mex by the documented way. Arguments: folder for the binary.
given = argv();
build_glrender_mex(given{end});
check(exist(fullfile(given{end}, 'glrender_mex.mex'), 'file') > 0, 'no binary');
fprintf('GLRENDER CHECKED\n');
