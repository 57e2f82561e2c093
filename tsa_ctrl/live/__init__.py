"""`tsa live`: signals, events and parameters of a running daemon on a WebSocket for Foxglove and PlotJuggler."""
