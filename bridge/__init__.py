"""The running program: sources, drivers, engine, recording, sinks and the command line."""
