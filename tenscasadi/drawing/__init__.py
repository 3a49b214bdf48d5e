"""Content, colors and shapes of pictures, for plots, viewer and exporters."""
