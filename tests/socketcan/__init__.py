"""The bridge on a real SocketCAN bus: the host's own, or that of a kernel in user mode."""
