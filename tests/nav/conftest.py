"""Kernels compile inside the first example, so examples have no deadline here."""

from hypothesis import settings

settings.register_profile("kernels", deadline=None, max_examples=60)
settings.load_profile("kernels")
