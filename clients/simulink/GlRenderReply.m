classdef GlRenderReply < handle
%GLRENDERREPLY  A rendered frame.
%   reply.pixels          the image, height x width, row 1 on top; irradiance [W/m2 per pixel] or digital numbers;
%                         of output 'compressed' the stream, a column of uint8
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
    Index  % of the frame in a request for several; 0 where there is one
    Header = []
  end

  methods
    function self = GlRenderReply(arrays, header_bytes, index)
      self.arrays = arrays;
      self.Bytes = header_bytes;
      self.Index = 0;
      if nargin > 2
        self.Index = index;
      end
    end

    function pixels = get.pixels(self)
      pixels = self.arrays.image;
    end

    function header = get.header(self)
      if isempty(self.Header)
        self.Header = glr_unpack(self.Bytes);
        if self.Index
          own = self.Header.frames{self.Index};
          self.Header = rmfield(self.Header, 'frames');
          for name = fieldnames(own).'
            self.Header.(name{1}) = own.(name{1});
          end
        end
      end
      header = self.Header;
    end
  end
end
