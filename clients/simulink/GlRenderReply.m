classdef GlRenderReply < handle
%GLRENDERREPLY  A rendered frame.
%   reply.pixels          the image, height x width, row 1 on top; irradiance [W/m2 per pixel] or digital numbers
%   reply.arrays          struct: image, and each product asked for
%   reply.header          struct: plan, timings_ms, t_s, unit, exposure_s, seed, ...; read when first asked for

  properties (SetAccess = private)
    arrays
  end

  properties (Dependent)
    pixels
    header
  end

  properties (Access = private)
    Bytes
    Header = []
  end

  methods
    function self = GlRenderReply(arrays, header_bytes)
      self.arrays = arrays;
      self.Bytes = header_bytes;
    end

    function pixels = get.pixels(self)
      pixels = self.arrays.image;
    end

    function header = get.header(self)
      if isempty(self.Header)
        self.Header = glr_unpack(self.Bytes);
      end
      header = self.Header;
    end
  end
end
