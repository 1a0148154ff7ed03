function build_glrender_mex(folder)
%BUILD_GLRENDER_MEX  Compile glrender_mex, the C client as a function; in MATLAB with Simulink also sfun_glrender_c.
%   Needs the C compiler that `mex -setup C` finds; in GNU Octave mkoctfile (Debian: octave-dev).
%   folder: where the binaries go (default: this file's folder).
  here = fileparts(mfilename('fullpath'));
  if nargin < 1
    folder = here;
  end
  names = {'glr_client.c', 'glr_request.c', 'glr_reply.c', 'glr_socket.c', 'glr_wire.c'};
  sources = cellfun(@(name) fullfile(here, name), names, 'UniformOutput', false);
  if exist('OCTAVE_VERSION', 'builtin')
    before = cd(folder);  % objects and binary land in the current folder
    back = onCleanup(@() cd(before));
    mkoctfile('--mex', ['-I', here], '-o', fullfile(folder, 'glrender_mex.mex'), fullfile(here, 'glrender_mex.c'), sources{:});
    if ~exist(fullfile(folder, 'glrender_mex.mex'), 'file')
      error('glrender:build', 'mkoctfile failed; its messages are above');
    end
    return
  end
  libraries = {};
  if ispc()
    libraries = {'-lws2_32'};
  end
  mex('-outdir', folder, fullfile(here, 'glrender_mex.c'), sources{:}, libraries{:});
  if exist('simulink', 'file')
    mex('-outdir', folder, fullfile(here, 'sfun_glrender_c.c'), sources{:}, libraries{:});
  end
end
