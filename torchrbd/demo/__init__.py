"""The bundled demo case, recorded in MuJoCo by ``examples/demo_case.py``.

``arm.urdf``, ``fit.parquet`` (40 s) and ``holdout.parquet`` (20 s) are what an engineer would have. ``truth.json``
holds what was concealed; only tests read it.
"""
