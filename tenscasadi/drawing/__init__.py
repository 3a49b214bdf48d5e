"""Pictures: content, colors and shapes, for plots, viewer and exporters."""
