"""Content, colors and shapes of pictures, shared by plots, the viewer and exporters."""
