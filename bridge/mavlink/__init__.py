"""MAVLink behind the recorder: our end of a link, its protocol machines, and the conversion to its axes.

Framing, signatures and sockets are the source's work; what is here sees recorded packets only.
"""
