"""Write the .mat files of version 7.3 beside this file: ``pip install hdf5storage==0.2.2; python write.py``.

hdf5storage lays files out as MATLAB does, and is not the library that reads them here.
"""

from pathlib import Path

import hdf5storage
import numpy as np

JOINTS, RATE_HZ, ROWS = ("a", "b"), 20, 40


def main() -> None:
    """Write arrays with the joints' names, the same in a structure, and a vector a column."""
    folder, t = Path(__file__).parent, np.arange(ROWS)[:, None] / RATE_HZ
    phase = t * [2.0, 5.0] + [0.2, 1.1]
    q, tau = np.sin(phase), 3.0 * np.cos(phase)
    names = np.array([JOINTS], dtype=object)
    arrays = {"t": t, "q": q, "tau": tau, "joints": names}
    by_column = {f"{key}_{joint}": x[:, k] for key, x in (("q", q), ("tau", tau)) for k, joint in enumerate(JOINTS)}
    contents = {
        "arrays": arrays,
        "structure": {"log": arrays},
        "columns": {"t": t.T, **by_column, "operator": "somebody", "load": 3.0},
    }
    for name, content in contents.items():
        path = folder / f"{name}.mat"
        hdf5storage.savemat(str(path), content, format="7.3", oned_as="column", store_python_metadata=False)


if __name__ == "__main__":
    main()
