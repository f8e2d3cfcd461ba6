"""An avatar that moves as somebody in front of a camera does: pictures in, smooth poses out."""
