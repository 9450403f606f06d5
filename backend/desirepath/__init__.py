"""Desire Path: people teach a mobile robot how to move around them.

One thread per process, set before NumPy loads: the cores are shared by server, browser and trainings, and results then
do not depend on how many cores a machine has. Set the variables yourself to choose otherwise.
"""

import os

for _library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_library, "1")
