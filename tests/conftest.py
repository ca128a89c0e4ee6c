"""Each worker of a parallel run has a core of its own."""

import os

if "PYTEST_XDIST_WORKER" in os.environ:
    # Torch and BLAS would start as many threads as there are cores in every worker, which would wait for each other:
    # training takes several times as long. Both read it when they are imported, as do the processes that tests start.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
