"""The vision head of Ting et al. (RSS 2006): identify with every method, then control with what each has found.

Run it with ``python -m examples.vision_head``; it needs MuJoCo: ``pip install torchrbd[examples]``.
"""
